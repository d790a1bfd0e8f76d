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
        estimate->measured[j] = estimate->external[j] = NAN;
#if LIMO_CONTACT
        estimate->threshold[j] = NAN;
        estimate->contact[j] = estimate->known[j] = false;
#endif
    }
}

/* Not so large either that squares of derivatives overflow, and stay in the memory of effects. */
static bool all_finite(const double x[N])
{
    for (int j = 0; j < N; ++j) {
        if (!(fabs(x[j]) <= LARGEST)) {
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

static void push(double *line, size_t *oldest, size_t taps, size_t width, const double *row)
{
    memcpy(line + *oldest * width, row, width * sizeof *row);
    memcpy(line + (*oldest + taps) * width, row, width * sizeof *row);
    *oldest = (*oldest + 1) % taps;
}

/* Take a row, and before it those that were lost, on a line; the first is taken for all before. */
static void receive(double *line, size_t *oldest, size_t taps, size_t width, bool first,
                    double lost, const double *row)
{
    double rise[LIMO_TORQUES * LIMO_LANES], between[LIMO_TORQUES * LIMO_LANES];
    for (size_t i = 0; first && i < taps; ++i) {
        push(line, oldest, taps, width, row);
    }
    const double *before = line + (*oldest + taps - 1) * width;
    for (size_t l = 0; l < width; ++l) {
        rise[l] = (row[l] - before[l]) / (lost + 1.0);
    }
    for (double i = fmin(lost, (double)taps - 1.0); i >= 0.0; i -= 1.0) {
        for (size_t l = 0; l < width; ++l) {
            between[l] = row[l] - i * rise[l];
        }
        push(line, oldest, taps, width, between);
    }
}

/* Rows are taken several at a time, since each sum waits for the one before. */
static void smooth(const limo_state *state, double x[2 * LIMO_LANES],
                   double other[FILTERS - 1][LIMO_LANES])
{
    enum { ROWS = 8 };
    double sum[FILTERS + 1][LIMO_LANES] = {{0.0}}; /* the last of torques */
    size_t i = 0;
    for (; i + ROWS <= TAPS; i += ROWS) {
        const double(*row)[2 * LIMO_LANES] = state->line + state->oldest + i;
        for (int l = 0; l < LIMO_LANES; ++l) {
            double part[FILTERS + 1] = {0.0};
            for (int k = 0; k < ROWS; ++k) {
                for (int f = 0; f < FILTERS; ++f) {
                    part[f] += taps[i + k][f] * row[k][l];
                }
                part[FILTERS] += taps[i + k][0] * row[k][LIMO_LANES + l];
            }
            for (int f = 0; f <= FILTERS; ++f) {
                sum[f][l] += part[f];
            }
        }
    }
    for (; i < TAPS; ++i) {
        const double *row = state->line[state->oldest + i];
        for (int l = 0; l < LIMO_LANES; ++l) {
            for (int f = 0; f < FILTERS; ++f) {
                sum[f][l] += taps[i][f] * row[l];
            }
            sum[FILTERS][l] += taps[i][0] * row[LIMO_LANES + l];
        }
    }
    memcpy(x, sum[0], sizeof sum[0]);
    memcpy(x + LIMO_LANES, sum[FILTERS], sizeof sum[0]);
    memcpy(other, sum[1], (FILTERS - 1) * sizeof sum[0]);
}

#if LIMO_RESTS
/* Take velocity and acceleration from joints whose newest positions are where they rest. */
static void rest(limo_state *state, const double position[N],
                 double motion[FILTERS - 1][LIMO_LANES])
{
    for (int j = 0; j < N; ++j) {
        double *own = state->anchors[j]; /* position, of how many, held for; noise², of how many */
        const double newest = motion[2][j], square = motion[3][j] * motion[3][j];
        if (own[4] < 0.0) { /* made up */
            own[4] += 1.0;
        } else if (square > NOTHING * NOTHING || fabs(newest - position[j]) > NOTHING) {
            if (own[4] == 0.0) {
                own[3] = square;
            }
            own[4] = fmin(own[4] + 1.0, NOISE_SAMPLES);
            own[3] += (fmin(square, FAR_NOISE * own[3] + NOTHING * NOTHING) - own[3]) / own[4];
        }
        const double away = newest - own[0];
        const double shares = 1.0 / (TAPS / 2) + 1.0 / fmax(own[1], 1.0);
        if (own[1] > 0.0 && fabs(away) <= NOTHING + BAND * sqrt(own[3] * shares)) {
            own[1] = fmin(own[1] + 1.0, ANCHOR_SAMPLES);
            own[2] += 1.0;
            own[0] += away / own[1];
        } else {
            own[0] = newest;
            own[1] = TAPS / 2;
            own[2] = 0.0;
        }
        if (own[2] >= SETTLED_SAMPLES) {
            motion[0][j] = motion[1][j] = 0.0;
        }
    }
}
#endif

#if LIMO_TORQUE_TAPS > 1
/* Filter the model's torques as the measured ones, which take their place beside them. */
static void smooth_torques(limo_state *state, bool first, double lost, double measured[LIMO_LANES],
                           limo_estimate *estimate)
{
    double *const parts[LIMO_TORQUES] = {estimate->simulation, estimate->gravity,
                                         estimate->payload, estimate->friction, measured};
    double row[LIMO_TORQUES * LIMO_LANES] = {0.0}, smoothed[LIMO_TORQUES * LIMO_LANES] = {0.0};
    for (int k = 0; k < LIMO_TORQUES; ++k) {
        memcpy(row + k * LIMO_LANES, parts[k], N * sizeof *row);
    }
    receive(state->torques[0], &state->oldest_torque, LIMO_TORQUE_TAPS, LIMO_TORQUES * LIMO_LANES,
            first, lost, row);
    for (size_t i = 0; i < LIMO_TORQUE_TAPS; ++i) {
        const double *given = state->torques[state->oldest_torque + i];
        for (int l = 0; l < LIMO_TORQUES * LIMO_LANES; ++l) {
            smoothed[l] += torque_taps[i] * given[l];
        }
    }
    for (int k = 0; k < LIMO_TORQUES; ++k) {
        memcpy(parts[k], smoothed + k * LIMO_LANES, N * sizeof *row);
    }
    for (int j = 0; j < N; ++j) {
        estimate->torque[j] = estimate->simulation[j] + estimate->learned[j];
    }
}
#endif

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
#if LIMO_RESTS
    memset(state->anchors, 0, sizeof state->anchors);
    for (int j = 0; j < N; ++j) {
        state->anchors[j][4] = -TAPS;
    }
#endif
#if LIMO_CONTACT
    for (int j = 0; j < N; ++j) {
        state->lowest[j] = INFINITY;
        state->highest[j] = -INFINITY;
        state->contact[j] = false;
        state->unlike[j] = 0;
    }
#endif
#if LIMO_TORQUE_TAPS > 1
    state->oldest_torque = 0;
    memset(state->torques, 0, sizeof state->torques);
#endif
    limo_model_init(&state->model);
}

void limo_reset(limo_state *state)
{
    limo_init(state);
}

#if LIMO_CONTACT
/* Whether free motion had such a speed, acceleration and torque: else nobody knows the error. */
static bool shown(int j, double velocity, double acceleration, double torque)
{
    const double now[3] = {velocity, acceleration, torque};
    for (int k = 0; k < 3; ++k) {
        if (!(free_least[j][k] <= now[k] && now[k] <= free_most[j][k])) {
            return false;
        }
    }
    return free_speeds[j][fabs(velocity) < SLOW ? 0 : 1] > 0.0;
}
#endif

limo_status limo_step(limo_state *state, double time, const double position[N],
                      const double *torque, limo_estimate *estimate)
{
    double row[2 * LIMO_LANES] = {0.0}, x[2 * LIMO_LANES], motion[FILTERS - 1][LIMO_LANES];
    if (!isfinite(time) || !all_finite(position) || (torque && !all_finite(torque))) {
        return LIMO_NOT_FINITE;
    }
    /* Far ahead is a long gap. Far back, a clock was set back, or the last time was wrong. */
    if (state->received && fabs(time - state->time) > LONGEST_GAP) {
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
    const bool first = !state->received;
    const double lost = first ? 0.0 : fmax(rint((time - state->time) * LIMO_RATE), 1.0) - 1.0;
    receive(state->line[0], &state->oldest, TAPS, 2 * LIMO_LANES, first, lost, row);
    /* Memory outlives a short gap; what the filter tells does not. */
    state->received = time > state->time + LONGEST_STEP ? 0 : state->received;
    state->received += state->received < SIZE_MAX;
    state->time = time;
    state->with_torque = torque != NULL;
    smooth(state, x, motion);
#if LIMO_RESTS
    rest(state, x, motion);
#endif
    evaluate(&state->model, time - TAPS / 2 / LIMO_RATE, x, motion[0], motion[1], estimate);
#if LIMO_TORQUE_TAPS > 1
    smooth_torques(state, first, lost, x + LIMO_LANES, estimate);
    estimate->time = time - LIMO_DELAY;
#endif
    estimate->filled = state->received >= TAPS + LIMO_TORQUE_TAPS - 1;
#if LIMO_CONTACT
    for (int j = 0; j < N; ++j) {
        state->lowest[j] = fmin(state->lowest[j], position[j]);
        state->highest[j] = fmax(state->highest[j], position[j]);
        state->unlike[j] -= state->unlike[j] > 0;
        if (!shown(j, motion[0][j], motion[1][j], estimate->simulation[j])) {
            state->unlike[j] = UNLIKE_SAMPLES;
        }
    }
#endif
    for (int j = 0; torque && j < N; ++j) {
        estimate->measured[j] = x[LIMO_LANES + j];
        estimate->external[j] = estimate->measured[j] - estimate->torque[j];
#if LIMO_CONTACT
        if (isnan(estimate->deviation[j])) { /* the model knows none: that of free motion */
            estimate->deviation[j] = free_error[j];
        }
        estimate->threshold[j] = contact_above[j] * estimate->deviation[j];
        estimate->known[j] = estimate->filled && !estimate->outside[j] && !state->unlike[j] &&
                             state->highest[j] - state->lowest[j] >= TURNED;
        if (estimate->filled) { /* else a gap is short, and what touched the arm may still */
            state->contact[j] =
                estimate->known[j] && fabs(estimate->external[j]) > estimate->threshold[j];
        }
        estimate->contact[j] = state->contact[j];
#endif
    }
    return LIMO_OK;
}
