/* For programs without the header: many positions in one call, and one with a bound. */

/* Take rows of positions and, where they are measured, torques; write of each estimate its time, then
 * of all joints simulation, learned, deviation, measured and outside. Return how many rows were
 * taken: the next one was refused. */
size_t limo_advance(limo_state *state, size_t count, int measured, const double *time,
                    const double *given, double *estimates);

size_t limo_advance(limo_state *state, size_t count, int measured, const double *time,
                    const double *given, double *estimates)
{
    for (size_t t = 0; t < count; ++t, given += measured ? 2 * N : N) {
        limo_estimate now;
        if (limo_step(state, time[t], given, measured ? given + N : NULL, &now) != LIMO_OK) {
            return t;
        }
        *estimates++ = now.time;
        const double *const parts[] = {now.simulation, now.learned, now.deviation, now.measured};
        for (size_t k = 0; k < sizeof parts / sizeof *parts; ++k, estimates += N) {
            memcpy(estimates, parts[k], N * sizeof *estimates);
        }
        for (int j = 0; j < N; ++j) {
            *estimates++ = now.outside[j];
        }
    }
    return count;
}

/* Take a position, and the torque measured with it, or NULL. Write the torque with what was learned
 * within a bound. Return 0 where the position was refused, else 1, and 2 more where the bound was
 * met, and 4 where a torque is not finite. */
int limo_answer(limo_state *state, double time, const double *position, const double *measured,
                const double *bound, double *torque, double *deviation, double *external,
                bool *outside);

int limo_answer(limo_state *state, double time, const double *position, const double *measured,
                const double *bound, double *torque, double *deviation, double *external,
                bool *outside)
{
    limo_estimate now;
    int found = 1;
    if (limo_step(state, time, position, measured, &now) != LIMO_OK) {
        return 0;
    }
    for (int j = 0; j < N; ++j) {
        if (fabs(now.learned[j]) > bound[j]) {
            now.learned[j] = copysign(bound[j], now.learned[j]);
            found |= 2;
        }
        torque[j] = now.simulation[j] + now.learned[j];
        external[j] = now.measured[j] - torque[j];
        found |= isfinite(torque[j]) ? 0 : 4;
    }
    memcpy(deviation, now.deviation, sizeof now.deviation);
    memcpy(outside, now.outside, sizeof now.outside);
    return found;
}
