/* Network: features of the motion and what was trained on them. */

/* Advance the extremes of a joint, (turn, extreme, direction, last); return the step. */
static double turn(double own[4], double q)
{
    if (isnan(own[3])) {
        own[0] = own[1] = own[3] = q;
    }
    const double step = q - own[3];
    own[3] = q;
    if (own[2] == 0.0) {
        if (fabs(q - own[0]) > REVERSAL) {
            own[2] = q > own[0] ? 1.0 : -1.0;
            own[1] = q;
        }
    } else if ((q - own[1]) * own[2] >= 0.0) {
        own[1] = q;
    } else if (fabs(q - own[1]) > REVERSAL) {
        own[0] = own[1];
        own[1] = q;
        own[2] = -own[2];
    }
    return step;
}

static void fill_inputs(limo_memory *memory, const double q[N], const double v[N],
                        const double a[N], const double torque[N], const double deflection[N],
                        double x[INPUTS])
{
    for (int j = 0; j < N; ++j) {
        double *own = memory->joints + FEATURE_MEMORY * j, quantity[QUANTITIES];
        const double step = turn(own, q[j]);
        quantity[0] = q[j];
        quantity[1] = v[j];
        quantity[2] = a[j];
        quantity[3] = fmin(fmax(q[j] - own[0], -SATURATION), SATURATION);
        quantity[4] = torque[j];
        for (int i = 0; i < FEATURE_STOPS; ++i) {
            own[4 + i] = fmin(fmax(own[4 + i] + step, -stop_width[i]), stop_width[i]);
            quantity[5 + i] = own[4 + i];
        }
        for (int i = 0; i < FEATURE_SPEEDS; ++i) {
            quantity[5 + FEATURE_STOPS + i] = tanh(v[j] / direction_speed[i]);
        }
        if (HAS_DEFLECTION) {
            quantity[QUANTITIES - 1] = deflection[j];
        }
        for (int i = 0; i < QUANTITIES; ++i) {
            if (place[i] >= 0) {
                x[place[i] * N + j] = quantity[i];
            }
        }
    }
}

/* Clip and normalise the inputs; write how far each joint's lie beyond those of training. */
static void normalise(double x[INPUTS], double beyond[N])
{
    for (int j = 0; j < N; ++j) {
        beyond[j] = 0.0;
        for (int i = 0; i < JOINT_INPUTS; ++i) {
            const int k = joint_input[j][i];
            const double excess = fmax(lowest[k] - x[k], x[k] - highest[k]);
            beyond[j] = fmax(beyond[j], excess / input_std[k]);
        }
    }
    for (int k = 0; k < INPUTS; ++k) {
        x[k] = (fmin(fmax(x[k], lowest[k]), highest[k]) - input_mean[k]) / input_std[k];
    }
}

static void learn(limo_memory *memory, const double load[N], const double q[N],
                  const double v[N], const double a[N], limo_estimate *estimate)
{
    double x[INPUTS], y[N], beyond[N], deflection[N] = {0.0};
    if (STANDALONE) {
        for (int j = 0; j < N; ++j) {
            estimate->simulation[j] = 0.0;
        }
    }
#if HAS_DEFLECTION
    {
        double bent[N], torque[N][POSES];
        poses at;
        for (int j = 0; j < N; ++j) {
            bent[j] = q[j] - COMPLIANCE * estimate->simulation[j];
        }
        pose(&at, 0, bent, v, a);
        inverse_dynamics(link, &at, 1, torque);
        for (int j = 0; j < N; ++j) {
            deflection[j] = torque[j][0] - load[j];
        }
    }
#else
    (void)load;
#endif
    fill_inputs(memory, q, v, a, estimate->simulation, deflection, x);
    normalise(x, beyond);
    run_network(memory->network, x, y);
    for (int j = 0; j < N; ++j) {
        const double unknown_part = beyond[j] * unknown[j];
        estimate->learned[j] = output_slope[j] * y[j] + output_offset[j];
        estimate->deviation[j] = sqrt(error[j] * error[j] + unknown_part * unknown_part);
        estimate->outside[j] = beyond[j] > 0.1;
    }
}
