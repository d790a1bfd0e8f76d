/* Runs an exported model over rows of doubles from standard input; writes estimates as doubles.
 * Rows are time and positions; with "torque", torques too; with "motion", velocities and
 * accelerations, for the model without filter. */
#include "limo.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define N LIMO_JOINTS

static void write(const double *values, size_t count)
{
    if (fwrite(values, sizeof *values, count, stdout) != count) {
        exit(2);
    }
}

int main(int argc, char **argv)
{
    static limo_state state;
    static limo_memory memory;
    const char *mode = argc > 1 ? argv[1] : "position";
    const size_t more = strcmp(mode, "torque") == 0 ? N : strcmp(mode, "motion") == 0 ? 2 * N : 0;
    double row[1 + 3 * N];
    limo_init(&state);
    limo_model_init(&memory);
    if (limo_size() != sizeof state) {
        return 1;
    }
    while (fread(row, sizeof *row, 1 + N + more, stdin) == 1 + N + more) {
        limo_estimate e;
        memset(&e, 0, sizeof e);
        const double *rest = row + 1 + N;
        const limo_status status =
            more == 2 * N ? limo_model_step(&memory, row[0], row + 1, rest, rest + N, &e)
                          : limo_step(&state, row[0], row + 1, more ? rest : NULL, &e);
        const double head[3] = {(double)status, e.time, e.filled ? 1.0 : 0.0};
        double flags[3 * N], threshold[N];
        for (int j = 0; j < N; ++j) {
            flags[j] = e.outside[j] ? 1.0 : 0.0;
            flags[N + j] = flags[2 * N + j] = 0.0;
            threshold[j] = 0.0;
#if LIMO_CONTACT
            flags[N + j] = e.contact[j] ? 1.0 : 0.0;
            flags[2 * N + j] = e.known[j] ? 1.0 : 0.0;
            threshold[j] = e.threshold[j];
#endif
        }
        write(head, 3);
        write(e.torque, N);
        write(e.simulation, N);
        write(e.learned, N);
        write(e.deviation, N);
        write(e.gravity, N);
        write(e.payload, N);
        write(e.friction, N);
        write(e.measured, N);
        write(e.external, N);
        write(threshold, N);
        write(flags, 3 * N);
    }
    return 0;
}
