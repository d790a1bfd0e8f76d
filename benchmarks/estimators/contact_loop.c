/* Runs an exported model over rows of doubles (time, positions, torques) from standard input; writes of
 * every row external torque, threshold, and contact (1) and known (2) of all joints. */
#include "limo.h"

#include <stdio.h>

#define N LIMO_JOINTS

int main(void)
{
    static limo_state state;
    static limo_estimate e;
    double row[1 + 2 * N];
    limo_init(&state);
    while (fread(row, sizeof *row, 1 + 2 * N, stdin) == 1 + 2 * N) {
        double flags[N];
        limo_step(&state, row[0], row + 1, row + 1 + N, &e); /* refused: all is as before */
        for (int j = 0; j < N; ++j) {
            flags[j] = (e.contact[j] ? 1.0 : 0.0) + (e.known[j] ? 2.0 : 0.0);
        }
        fwrite(e.external, sizeof *e.external, N, stdout);
        fwrite(e.threshold, sizeof *e.threshold, N, stdout);
        fwrite(flags, sizeof *flags, N, stdout);
    }
    return 0;
}
