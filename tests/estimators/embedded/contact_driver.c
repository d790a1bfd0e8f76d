/* Reads news from standard input (time, length, bytes); writes after each whether it was any, and
 * what is known of joints 0 to 8 then and a second later. */
#include "contact_state.h"

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

int main(void)
{
    static contact_state state;
    double now;
    uint32_t length;
    while (fread(&now, sizeof now, 1, stdin) == 1 && fread(&length, sizeof length, 1, stdin) == 1) {
        char *payload = malloc(length); /* of its size, so that a sanitizer sees what is read beyond */
        if (fread(payload, 1, length, stdin) != length) {
            return 1;
        }
        printf("%d", contact_read(&state, payload, length, now));
        for (size_t joint = 0; joint <= 8; ++joint) {
            printf(" %d%d", contact_of(&state, joint, now), contact_of(&state, joint, now + 1.0));
        }
        puts("");
        free(payload);
    }
    return 0;
}
