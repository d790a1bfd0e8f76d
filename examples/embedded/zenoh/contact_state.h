/* What `limo/<arm>/contact` says, read in C11 without a library: whether something leans on a joint,
 * nothing does, or nobody knows. A `contact_state` of zeros knows nothing. */
#ifndef CONTACT_STATE_H
#define CONTACT_STATE_H

#include <stdbool.h>
#include <stddef.h>
#include <string.h>

#define CONTACT_JOINTS 32
#define CONTACT_PATIENCE 0.3 /* [s] without news, after which nothing is known */

typedef enum { CONTACT_UNKNOWN, CONTACT_FREE, CONTACT_FELT } contact_touch;

typedef struct {
    double heard; /* when the last news came, on the clock of who listens [s] */
    size_t count; /* joints; 0 before any news */
    contact_touch joints[CONTACT_JOINTS];
} contact_state;

typedef struct {
    const char *at, *end;
} contact_text;

static inline bool contact_next(contact_text *text, char wanted)
{
    while (text->at < text->end && strchr(" \t\r\n", *text->at) && *text->at) {
        ++text->at;
    }
    if (text->at == text->end || *text->at != wanted) {
        return false;
    }
    ++text->at;
    return true;
}

/* Take a string; an escaped character stays as it is written. */
static inline bool contact_string(contact_text *text, const char **start, size_t *length)
{
    if (!contact_next(text, '"')) {
        return false;
    }
    for (*start = text->at; text->at < text->end; ++text->at) {
        if (*text->at == '"') {
            *length = (size_t)(text->at++ - *start);
            return true;
        }
        if (*text->at == '\\' && ++text->at == text->end) {
            return false;
        }
    }
    return false;
}

/* Pass over a string, a number or a name. */
static inline bool contact_plain(contact_text *text)
{
    const char *start;
    size_t length;
    if (contact_string(text, &start, &length)) {
        return true;
    }
    for (start = text->at; text->at < text->end && !strchr("[]{},:\"", *text->at); ++text->at) {
    }
    return start != text->at;
}

/* Pass over one of these, or an array of them. */
static inline bool contact_skip(contact_text *text)
{
    if (!contact_next(text, '[')) {
        return contact_plain(text);
    }
    if (contact_next(text, ']')) {
        return true;
    }
    do {
        if (!contact_plain(text)) {
            return false;
        }
    } while (contact_next(text, ','));
    return contact_next(text, ']');
}

static inline bool contact_joints(contact_text *text, contact_state *found)
{
    static const char *const names[] = {"unknown", "free", "contact"};
    if (!contact_next(text, '[')) {
        return false;
    }
    for (found->count = 0; found->count < CONTACT_JOINTS; ++found->count) {
        const char *start;
        size_t length, k = 0;
        if (!contact_string(text, &start, &length)) {
            return false;
        }
        while (k < 3 && (strlen(names[k]) != length || memcmp(names[k], start, length) != 0)) {
            ++k;
        }
        if (k == 3) {
            return false;
        }
        found->joints[found->count] = (contact_touch)k;
        if (!contact_next(text, ',')) {
            ++found->count;
            return contact_next(text, ']');
        }
    }
    return false;
}

/* Take news that came at `now` [s]; false where it is none, and then nothing has changed. */
static inline bool contact_read(contact_state *state, const char *payload, size_t length, double now)
{
    contact_text text = {payload, payload + length};
    contact_state found = {now, 0, {CONTACT_UNKNOWN}};
    if (!contact_next(&text, '{')) {
        return false;
    }
    do {
        const char *key;
        size_t size;
        if (!contact_string(&text, &key, &size) || !contact_next(&text, ':')) {
            return false;
        }
        if (size == 6 && memcmp(key, "joints", 6) == 0) {
            if (!contact_joints(&text, &found)) {
                return false;
            }
        } else if (!contact_skip(&text)) {
            return false;
        }
    } while (contact_next(&text, ','));
    if (!contact_next(&text, '}') || found.count == 0) {
        return false;
    }
    *state = found;
    return true;
}

/* Say whether something leans on a joint, numbered from 1, at `now` [s]. */
static inline contact_touch contact_of(const contact_state *state, size_t joint, double now)
{
    const bool known = joint >= 1 && joint <= state->count && now - state->heard <= CONTACT_PATIENCE;
    return known ? state->joints[joint - 1] : CONTACT_UNKNOWN;
}

#endif
