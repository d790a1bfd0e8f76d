/* The estimate of one motion. */

static void evaluate(limo_memory *memory, double time, const double q[N], const double v[N],
                     const double a[N], limo_estimate *estimate)
{
    double load[N], other[N] = {0.0}, friction[N] = {0.0}, displacement[N] = {0.0};
    double torque[N][POSES];
    poses at;
    pose(&at, 0, q, v, a);
    for (int j = 0; j < N; ++j) { /* at rest */
        at.c[j][1] = at.c[j][0];
        at.s[j][1] = at.s[j][0];
        at.v[j][1] = at.a[j][1] = 0.0;
    }
#if LEARNS_JOINT_PHYSICS
    for (int l = 2; l < POSES; ++l) {
        for (int j = 0; j < N; ++j) {
            at.c[j][l] = at.c[j][0];
            at.s[j][l] = at.s[j][0];
            at.v[j][l] = v[j];
            at.a[j][l] = a[j];
        }
    }
    for (int m = 0; m < N; ++m) { /* joint m a little ahead, and behind */
        const double c = at.c[m][0], s = at.s[m][0];
        at.c[m][2 + 2 * m] = c * COS_DIFFERENCE - s * SIN_DIFFERENCE;
        at.s[m][2 + 2 * m] = s * COS_DIFFERENCE + c * SIN_DIFFERENCE;
        at.c[m][3 + 2 * m] = c * COS_DIFFERENCE + s * SIN_DIFFERENCE;
        at.s[m][3 + 2 * m] = s * COS_DIFFERENCE - c * SIN_DIFFERENCE;
    }
    inverse_dynamics(link, &at, POSES, torque);
#else
    inverse_dynamics(link, &at, 2, torque);
#endif
    for (int j = 0; j < N; ++j) {
        load[j] = torque[j][0];
        estimate->gravity[j] = torque[j][1];
        estimate->payload[j] = 0.0;
    }
#if HAS_PAYLOAD
    {
        double carried[N][POSES];
        inverse_dynamics(payload, &at, 1, carried);
        for (int j = 0; j < N; ++j) {
            estimate->payload[j] = carried[j][0];
        }
    }
#endif
    act(memory, time, q, v, a, load, other, friction, displacement);
    for (int j = 0; j < N; ++j) {
        estimate->simulation[j] = load[j];
        estimate->friction[j] = friction[j];
        estimate->learned[j] = 0.0;
        estimate->deviation[j] = NAN;
        estimate->outside[j] = false;
    }
#if DISPLACES
    {
        double links[N], moved[N][POSES];
        poses there;
        for (int j = 0; j < N; ++j) {
            links[j] = q[j] - displacement[j];
        }
        pose(&there, 0, links, v, a);
        inverse_dynamics(link, &there, 1, moved);
        for (int j = 0; j < N; ++j) {
            estimate->simulation[j] = moved[j][0];
        }
    }
#endif
    for (int j = 0; j < N; ++j) {
        estimate->simulation[j] += other[j] + friction[j];
    }
    sense(memory, time, estimate->simulation);
#if LEARNS_JOINT_PHYSICS
    learn(memory, &at, (const double(*)[POSES])torque, q, v, a, estimate);
#elif LEARNS_BY_NETWORK
    learn(memory, load, q, v, a, estimate);
#endif
    estimate->time = time;
    estimate->filled = true;
    for (int j = 0; j < N; ++j) {
        estimate->torque[j] = estimate->simulation[j] + estimate->learned[j];
        estimate->measured[j] = estimate->external[j] = estimate->threshold[j] = NAN;
        estimate->contact[j] = false;
    }
}

static bool all_finite(const double x[N])
{
    for (int j = 0; j < N; ++j) {
        if (!isfinite(x[j])) {
            return false;
        }
    }
    return true;
}

void limo_model_init(limo_memory *memory)
{
    memcpy(memory->effects, effects_at_first, sizeof memory->effects);
    memcpy(memory->joints, joints_at_first, sizeof memory->joints);
    memset(memory->network, 0, sizeof memory->network);
}

limo_status limo_model_step(limo_memory *memory, double time, const double position[N],
                            const double velocity[N], const double acceleration[N],
                            limo_estimate *estimate)
{
    if (!isfinite(time) || !all_finite(position) || !all_finite(velocity) ||
        !all_finite(acceleration)) {
        return LIMO_NOT_FINITE;
    }
    evaluate(memory, time, position, velocity, acceleration, estimate);
    return LIMO_OK;
}

/* The motion behind the filter. */

static void push(limo_state *state, const double row[2 * LIMO_LANES])
{
    memcpy(state->line[state->oldest], row, sizeof state->line[0]);
    memcpy(state->line[state->oldest + TAPS], row, sizeof state->line[0]);
    state->oldest = (state->oldest + 1) % TAPS;
}

/* Rows are taken several at a time, since each sum waits for the one before. */
static void smooth(const limo_state *state, double x[2 * LIMO_LANES], double v[LIMO_LANES],
                   double a[LIMO_LANES])
{
    enum { ROWS = 8 };
    double q[LIMO_LANES] = {0.0}, dq[LIMO_LANES] = {0.0}, ddq[LIMO_LANES] = {0.0};
    double torque[LIMO_LANES] = {0.0};
    size_t i = 0;
    for (; i + ROWS <= TAPS; i += ROWS) {
        const double(*row)[2 * LIMO_LANES] = state->line + state->oldest + i;
        for (int l = 0; l < LIMO_LANES; ++l) {
            double part[4] = {0.0};
            for (int k = 0; k < ROWS; ++k) {
                part[0] += taps[i + k][0] * row[k][l];
                part[1] += taps[i + k][1] * row[k][l];
                part[2] += taps[i + k][2] * row[k][l];
                part[3] += taps[i + k][0] * row[k][LIMO_LANES + l];
            }
            q[l] += part[0];
            dq[l] += part[1];
            ddq[l] += part[2];
            torque[l] += part[3];
        }
    }
    for (; i < TAPS; ++i) {
        const double *row = state->line[state->oldest + i];
        for (int l = 0; l < LIMO_LANES; ++l) {
            q[l] += taps[i][0] * row[l];
            dq[l] += taps[i][1] * row[l];
            ddq[l] += taps[i][2] * row[l];
            torque[l] += taps[i][0] * row[LIMO_LANES + l];
        }
    }
    memcpy(x, q, sizeof q);
    memcpy(x + LIMO_LANES, torque, sizeof torque);
    memcpy(v, dq, sizeof dq);
    memcpy(a, ddq, sizeof ddq);
}

size_t limo_size(void)
{
    return sizeof(limo_state);
}

void limo_init(limo_state *state)
{
    state->time = NAN;
    state->oldest = state->received = 0;
    state->with_torque = false;
    memset(state->line, 0, sizeof state->line);
    limo_model_init(&state->model);
}

void limo_reset(limo_state *state)
{
    limo_init(state);
}

limo_status limo_step(limo_state *state, double time, const double position[N],
                      const double *torque, limo_estimate *estimate)
{
    double row[2 * LIMO_LANES] = {0.0}, x[2 * LIMO_LANES], v[LIMO_LANES], a[LIMO_LANES];
    if (!isfinite(time) || !all_finite(position) || (torque && !all_finite(torque))) {
        return LIMO_NOT_FINITE;
    }
    /* Far ahead is a gap. Far back, a clock was set back, or the last time was wrong. */
    if (state->received && fabs(time - state->time) > LONGEST_STEP) {
        limo_init(state);
    }
    if (state->received && !(time > state->time)) {
        return LIMO_TIME_STOOD;
    }
    if (state->received && state->with_torque != (torque != NULL)) {
        return LIMO_TORQUE_CHANGED;
    }
    for (int j = 0; j < N; ++j) {
        row[j] = position[j];
        row[LIMO_LANES + j] = torque ? torque[j] : 0.0;
    }
    double lost = 0.0;
    if (!state->received) {
        for (size_t i = 0; i < TAPS; ++i) {
            push(state, row);
        }
    } else {
        lost = fmax(rint((time - state->time) * LIMO_RATE), 1.0) - 1.0;
    }
    const double *before = state->line[state->oldest + TAPS - 1];
    double rise[2 * LIMO_LANES];
    for (int l = 0; l < 2 * LIMO_LANES; ++l) {
        rise[l] = (row[l] - before[l]) / (lost + 1.0);
    }
    for (double i = fmin(lost, TAPS - 1.0); i >= 0.0; i -= 1.0) { /* lost ones on a line */
        double between[2 * LIMO_LANES];
        for (int l = 0; l < 2 * LIMO_LANES; ++l) {
            between[l] = row[l] - i * rise[l];
        }
        push(state, between);
    }
    state->time = time;
    state->with_torque = torque != NULL;
    state->received += state->received < SIZE_MAX;
    smooth(state, x, v, a);
    evaluate(&state->model, time - LIMO_DELAY, x, v, a, estimate);
    estimate->filled = state->received >= TAPS;
    for (int j = 0; torque && j < N; ++j) {
        estimate->measured[j] = x[LIMO_LANES + j];
        estimate->external[j] = estimate->measured[j] - estimate->torque[j];
        estimate->threshold[j] = contact_above[j] * estimate->deviation[j];
        estimate->contact[j] = estimate->filled && !estimate->outside[j] &&
                               fabs(estimate->external[j]) > estimate->threshold[j];
    }
    return LIMO_OK;
}
