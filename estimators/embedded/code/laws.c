/*: interpolated */
static double interpolated(double x, size_t count, const double *at, const double *value)
{
    if (x <= at[0]) {
        return value[0];
    }
    for (size_t i = 1; i < count; ++i) {
        if (x < at[i]) {
            const double slope = (value[i] - value[i - 1]) / (at[i] - at[i - 1]);
            return slope * (x - at[i - 1]) + value[i - 1];
        }
    }
    return value[count - 1];
}

/*: warmth */
/* Memory: warmth, last time. */
static double warmth(double *memory, double time, double velocity, double constant)
{
    const double heat = tanh(fabs(velocity) / 0.01);
    if (!isnan(memory[1])) {
        memory[0] = heat + (memory[0] - heat) * exp(-(time - memory[1]) / constant);
    }
    memory[1] = time;
    return memory[0];
}

/*: stepped */
/* Return the step to a position, and remember it. */
static double stepped(double *last, double position)
{
    const double step = isnan(*last) ? 0.0 : position - *last;
    *last = position;
    return step;
}

/*: maxwell_slip */
/* Memory: deflections, last position. */
static double maxwell_slip(double *memory, double q, size_t count, const double *stiffness,
                           const double *width)
{
    const double step = stepped(memory + count, q);
    double torque = 0.0;
    for (size_t i = 0; i < count; ++i) {
        memory[i] = fmin(fmax(memory[i] + step, -width[i]), width[i]);
        torque += stiffness[i] * memory[i];
    }
    return torque;
}

/*: lugre */
/* Memory: deflection of the bristles, last position. */
static double lugre(double *memory, double q, double v, double sigma_0, double tau_c,
                    double sigma_1, double tau_s, double v_s)
{
    const double step = stepped(memory + 1, q);
    const double g = tau_c + tau_s * exp(-(v / v_s) * (v / v_s));
    const double end = copysign(g / sigma_0, step);
    const double z = end + (memory[0] - end) * exp(-sigma_0 * fabs(step) / g);
    memory[0] = z;
    return sigma_0 * z + sigma_1 * (v - sigma_0 * fabs(v) / g * z);
}

/*: dahl */
/* Memory: torque, last position. */
static double dahl(double *memory, double q, double sigma_0, double tau_c, double exponent)
{
    const double step = stepped(memory + 1, q), direction = step >= 0.0 ? 1.0 : -1.0;
    const double run = sigma_0 * fabs(step) / tau_c;
    double x = fmax(1.0 - memory[0] * direction / tau_c, 0.0);
    if (fabs(exponent - 1.0) < 1e-9) {
        x *= exp(-run);
    } else if (x > 0.0) {
        const double power = pow(x, 1.0 - exponent) + (exponent - 1.0) * run;
        x = power > 0.0 ? pow(power, 1.0 / (1.0 - exponent)) : 0.0;
    }
    memory[0] = direction * tau_c * (1.0 - x);
    return memory[0];
}

/*: bouc_wen */
static double bouc_wen_slope(double zeta, double beta_ratio, double exponent)
{
    const double sign = zeta >= 0.0 ? 1.0 : -1.0;
    return 1.0 - pow(fabs(zeta), exponent) * (beta_ratio * sign + 1.0 - beta_ratio);
}

/* Memory: torque over tau_c, last position. */
static double bouc_wen(double *memory, double q, double sigma_0, double tau_c, double beta_ratio,
                       double exponent)
{
    const double step = stepped(memory + 1, q), direction = step >= 0.0 ? 1.0 : -1.0;
    const double run = fmin(sigma_0 * fabs(step) / tau_c, 25.0);
    const double parts = ceil(run * fmax(exponent, 1.0) / 0.05);
    double zeta = memory[0] * direction;
    for (double i = 0.0; i < parts; i += 1.0) {
        const double h = run / parts;
        const double k1 = bouc_wen_slope(zeta, beta_ratio, exponent);
        if (fabs(k1) * run < 1e-12) { /* it slides */
            break;
        }
        const double k2 = bouc_wen_slope(zeta + 0.5 * h * k1, beta_ratio, exponent);
        const double k3 = bouc_wen_slope(zeta + 0.5 * h * k2, beta_ratio, exponent);
        const double k4 = bouc_wen_slope(zeta + h * k3, beta_ratio, exponent);
        zeta += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4);
    }
    memory[0] = direction * fmin(fmax(zeta, -1.0), 1.0);
    return tau_c * memory[0];
}

/*: preisach */
/* Memory: relays, 0 before the first position; last position. */
static double preisach(double *memory, double q, size_t count, const double *up,
                       const double *down, const double *weight)
{
    double torque = 0.0;
    for (size_t i = 0; i < count; ++i) {
        if (memory[i] == 0.0) {
            memory[i] = q > 0.5 * (up[i] + down[i]) ? 1.0 : -1.0;
        }
        if (q > up[i]) {
            memory[i] = 1.0;
        } else if (q < down[i]) {
            memory[i] = -1.0;
        }
        torque += weight[i] * memory[i];
    }
    return torque;
}

/*: inertia */
/* Return an entry of the diagonal of the mass matrix [kg m^2]. */
static double inertia(const double q[N], int j)
{
    const double still_joints[N] = {0.0};
    double unit[N] = {0.0}, torque[N][POSES];
    poses at;
    unit[j] = 1.0;
    pose(&at, 0, q, still_joints, unit);
    pose(&at, 1, q, still_joints, still_joints);
    inverse_dynamics(link, &at, 2, torque);
    return torque[j][0] - torque[j][1];
}

/*: held */
/* Return the torque that holds a joint at rest [N m]. */
static double held(const double q[N], int j)
{
    const double still_joints[N] = {0.0};
    double torque[N][POSES];
    poses at;
    pose(&at, 0, q, still_joints, still_joints);
    inverse_dynamics(link, &at, 1, torque);
    return torque[j][0];
}

/*: swing */
/* Memory: wind-up, torque of the spring, momentum; load, inertia and time of the last sample. */
static double swing(double *memory, double time, double load, double mass, double at_rest,
                    double compliance, double cubic, double damping)
{
    double x = memory[0], s = memory[1];
    const double h = time - memory[5], m = 0.5 * (memory[4] + mass);
    if (isnan(h)) {
        s = at_rest;
        x = s * (compliance + cubic * s * s);
        memory[2] = 0.0;
    } else if (h > 0.0) {
        const double slope = 1.0 / fmax(compliance + 3.0 * cubic * s * s, 0.05 * compliance);
        const double rate = (load - memory[3]) / (h * slope);
        const double rest = (memory[3] - s - damping * rate) / slope;
        const double decay = 0.5 * damping / m, square = slope / m;
        const double apart = decay * decay - square, w = sqrt(fabs(apart));
        double cosine, sine;
        if (apart < 0.0) {
            cosine = exp(-decay * h) * cos(w * h);
            sine = exp(-decay * h) * sin(w * h) / w;
        } else {
            const double slow = exp(-square / (decay + w) * h), fast = exp(-(decay + w) * h);
            cosine = 0.5 * (slow + fast);
            sine = w * h > 1e-6 ? 0.5 * (slow - fast) / w : h * slow;
        }
        const double off = memory[2] / m - rate;
        const double moved = rest + rate * h - rest * cosine + (off - decay * rest) * sine;
        memory[2] = m * (rate + off * cosine - (decay * off - square * rest) * sine);
        x += moved;
        s += slope * moved;
        s -= slope * (s * (compliance + cubic * s * s) - x);
    }
    memory[0] = x;
    memory[1] = s;
    memory[3] = load;
    memory[4] = mass;
    memory[5] = time;
    return x;
}

/*: play */
/* Memory: displacement of the link, its speed, last time. */
static double play(double *memory, double time, double ahead, double slowed, double flank)
{
    if (isnan(memory[2])) {
        memory[0] = ahead != 0.0 ? copysign(flank, ahead) : 0.0;
    } else {
        const double step = time - memory[2];
        const double speed = (memory[1] + ahead * step) / (1.0 + slowed * step);
        memory[0] += 0.5 * (memory[1] + speed) * step;
        memory[1] = speed;
    }
    if (fabs(memory[0]) >= flank) {
        memory[0] = copysign(flank, memory[0]);
        memory[1] = 0.0;
    }
    memory[2] = time;
    return memory[0];
}

/*: loose */
/* Return the part of the time around a sample, a step long, in which no flank of a play is met: a
 * joint that turned back within the step before is off the flank that it came from.
 * Memory: lead of the link over its drive, unused, last position. */
static double loose(double *memory, double q, double v, double flank)
{
    const double step = isnan(memory[2]) ? 0.0 : q - memory[2], x = memory[0] + step;
    memory[0] = fmin(fmax(x, -flank), flank);
    memory[2] = q;
    if (step != 0.0) {
        const double to = copysign(1.0, v != 0.0 ? v : step);
        return fmin(fmax(0.5 + (flank - to * x) / fabs(step), 0.0), 1.0);
    }
    return fabs(x) < flank ? 1.0 : 0.0;
}

/*: wound */
/* Return the part of its drag that a joint with play feels, with its sign, which comes up over a
 * width behind either flank. Memory: lead of the link over its drive, unused, last position. */
static double wound(double *memory, double q, double flank, double width)
{
    const double end = flank + width, step = isnan(memory[2]) ? 0.0 : q - memory[2];
    const double x = fmin(fmax(memory[0] + step, -end), end);
    memory[0] = x;
    memory[2] = q;
    return copysign(fmax(fabs(x) - flank, 0.0) / width, x);
}

/*: late */
/* Return a torque `delay` later, then behind a first-order lag.
 * Memory: time, input and output of the lag; how many samples are kept; their times; torques. */
static double late(double *memory, size_t most, double time, double torque, double delay,
                   double lag)
{
    double *at = memory + 4, *value = at + most;
    size_t kept = (size_t)memory[3];
    if (kept == most) { /* samples came faster than stated: the oldest is given up */
        memmove(at, at + 1, (kept - 1) * sizeof *at);
        memmove(value, value + 1, (kept - 1) * sizeof *value);
        --kept;
    }
    at[kept] = time;
    value[kept] = torque;
    ++kept;
    const double input = interpolated(time - delay, kept, at, value);
    const bool first = isnan(memory[0]);
    const double before = first ? time : memory[0], x = first ? input : memory[1];
    const double step = time - before;
    double y = first ? input : memory[2];
    if (lag <= 0.0) {
        y = input;
    } else if (step > 0.0) {
        const double slope = (input - x) / step;
        y = input - lag * slope + (y - x + lag * slope) * exp(-step / lag);
    }
    memory[0] = time;
    memory[1] = input;
    memory[2] = y;
    size_t past = 0; /* all but one sample before the delayed instant are done with */
    while (past + 1 < kept && at[past + 1] <= time - delay) {
        ++past;
    }
    kept -= past;
    memmove(at, at + past, kept * sizeof *at);
    memmove(value, value + past, kept * sizeof *value);
    memory[3] = (double)kept;
    return y;
}
