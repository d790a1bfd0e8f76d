/* What `limo/<arm>/torque/known` says, read in C11 without a library: external torque of each joint,
 * NaN where nobody knows, for how long memory has gone on, and by which model. An `external_torque`
 * of zeros knows nothing. For little-endian processors with doubles of IEEE 754. */
#ifndef EXTERNAL_TORQUE_H
#define EXTERNAL_TORQUE_H

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#define EXTERNAL_JOINTS 32
#define EXTERNAL_MODEL 64      /* bytes of its version that are kept, with the end */
#define EXTERNAL_PATIENCE 0.3  /* [s] without news, after which nothing is known */
#define EXTERNAL_HEAD 24       /* bytes ahead of the values */

typedef struct {
    double heard;                    /* when the last news came, on the clock of who listens [s] */
    size_t count;                    /* joints; 0 before any news */
    int64_t stamp_ns;                /* of the estimate, Unix time */
    double since_gap;                /* for how long memory has gone on then [s] */
    bool physics_only;               /* for want of a learned model */
    double torque[EXTERNAL_JOINTS];  /* [N m], NaN where nobody knows */
    double std[EXTERNAL_JOINTS];     /* [N m], one standard deviation, likewise */
    char model[EXTERNAL_MODEL];      /* its version */
} external_torque;

/* Take news that came at `now` [s]; false where it is none, and then nothing has changed. */
static inline bool external_read(external_torque *state, const void *payload, size_t length, double now)
{
    const unsigned char *const bytes = payload;
    external_torque found = {.heard = now};
    uint16_t count;
    size_t arrays, rest;
    if (length < EXTERNAL_HEAD || bytes[0] != 1) {
        return false;
    }
    memcpy(&count, bytes + 2, sizeof count);
    memcpy(&found.stamp_ns, bytes + 8, sizeof found.stamp_ns);
    memcpy(&found.since_gap, bytes + 16, sizeof found.since_gap);
    arrays = count * sizeof(double);
    if (count == 0 || count > EXTERNAL_JOINTS || length < EXTERNAL_HEAD + 2 * arrays ||
        !isfinite(found.since_gap) || found.since_gap < 0.0) {
        return false;
    }
    found.count = count;
    found.physics_only = bytes[1] & 1;
    memcpy(found.torque, bytes + EXTERNAL_HEAD, arrays);
    memcpy(found.std, bytes + EXTERNAL_HEAD + arrays, arrays);
    rest = length - EXTERNAL_HEAD - 2 * arrays;
    rest = rest < EXTERNAL_MODEL ? rest : EXTERNAL_MODEL - 1;
    memcpy(found.model, bytes + EXTERNAL_HEAD + 2 * arrays, rest);
    *state = found;
    return true;
}

/* Return the external torque of a joint, numbered from 1, at `now` [N m]; NaN where nobody knows. */
static inline double external_of(const external_torque *state, size_t joint, double now)
{
    const bool known = joint >= 1 && joint <= state->count && now - state->heard <= EXTERNAL_PATIENCE;
    return known ? state->torque[joint - 1] : (double)NAN;
}

#endif
