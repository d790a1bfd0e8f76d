/* Times an exported model over rows of doubles (time, positions, torques) from standard input. */
#define _POSIX_C_SOURCE 199309L

#include "limo.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define N LIMO_JOINTS

static int ascending(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* With "times", print p50 and p99 [us]; else write torque, deviation and status of every row. */
int main(int argc, char **argv)
{
    static limo_state state;
    static double row[1 + 2 * N], took[10000000];
    const int timed = argc > 1 && strcmp(argv[1], "times") == 0;
    size_t count = 0;
    limo_init(&state);
    while (fread(row, sizeof *row, 1 + 2 * N, stdin) == 1 + 2 * N) {
        limo_estimate e;
        struct timespec before, after;
        clock_gettime(CLOCK_MONOTONIC, &before);
        const double status = (double)limo_step(&state, row[0], row + 1, row + 1 + N, &e);
        clock_gettime(CLOCK_MONOTONIC, &after);
        took[count++ % 10000000] = 1e6 * (double)(after.tv_sec - before.tv_sec) +
                                   1e-3 * (double)(after.tv_nsec - before.tv_nsec);
        if (!timed) {
            fwrite(e.torque, sizeof *e.torque, N, stdout);
            fwrite(e.deviation, sizeof *e.deviation, N, stdout);
            fwrite(&status, sizeof status, 1, stdout);
        }
    }
    if (timed) {
        qsort(took, count, sizeof *took, ascending);
        printf("%.3f %.3f\n", took[count / 2], took[count * 99 / 100]);
    }
    return 0;
}
