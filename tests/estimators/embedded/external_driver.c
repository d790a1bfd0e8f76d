/* Reads news from standard input (time, length, bytes); writes after each whether it was any, what
 * is known of joints 0 to 4 then and a second later, and the rest of it. */
#include "external_torque.h"

#include <stdio.h>
#include <stdlib.h>

int main(void)
{
    static external_torque state;
    double now;
    uint32_t length;
    while (fread(&now, sizeof now, 1, stdin) == 1 && fread(&length, sizeof length, 1, stdin) == 1) {
        unsigned char *payload = malloc(length); /* of its size, for what is read beyond it */
        if (fread(payload, 1, length, stdin) != length) {
            return 1;
        }
        printf("%d", external_read(&state, payload, length, now));
        for (size_t joint = 0; joint <= 4; ++joint) {
            printf(" %.17g %.17g", external_of(&state, joint, now), external_of(&state, joint, now + 1.0));
        }
        printf(" %lld %.17g %d %.17g %s\n", (long long)state.stamp_ns, state.since_gap, state.physics_only,
               state.std[0], state.model);
        free(payload);
    }
    return 0;
}
