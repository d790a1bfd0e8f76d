/* Joint physics: what data add, linear in terms of each joint's own physics. */

/* Its sums nearly cancel, so that a product that is fused with its sum would show in the fifth
 * digit: Python fuses none. The compiler may fuse all others, whatever it is told. */
#if defined(__GNUC__) && !defined(__clang__)
#define AS_WRITTEN __attribute__((optimize("fp-contract=off")))
#define ONE_BY_ONE __attribute__((optimize("no-tree-vectorize")))
#else
#define AS_WRITTEN
#define ONE_BY_ONE
#endif

/* In place of fmin and fmax, which are calls, and keep what is around them from vectors. */
static inline double clipped(double x, double lowest, double highest)
{
    return x < lowest ? lowest : x > highest ? highest : x;
}

/* Replace each x by tanh(x): e / (e + 2) with e = exp(2 |x|) - 1, of all at once, in vectors. */
static void tanh_of(double x[DIRECTIONS])
{
    static const double log2_high = 0x1.62e42fee00000p-1, log2_low = 0x1.a39ef35793c76p-33;
    for (int i = 0; i < DIRECTIONS; ++i) {
        const double y = clipped(2.0 * fabs(x[i]), 0.0, 44.0); /* beyond, it is 1 to the last digit */
        const double shifted = y * 1.4426950408889634 + 0x1.8p52, k = shifted - 0x1.8p52;
        const double r = (y - k * log2_high) - k * log2_low;
        double e = 1.0 / 6227020800.0, power;
        uint64_t bits;
        e = e * r + 1.0 / 479001600.0;
        e = e * r + 1.0 / 39916800.0;
        e = e * r + 1.0 / 3628800.0;
        e = e * r + 1.0 / 362880.0;
        e = e * r + 1.0 / 40320.0;
        e = e * r + 1.0 / 5040.0;
        e = e * r + 1.0 / 720.0;
        e = e * r + 1.0 / 120.0;
        e = e * r + 1.0 / 24.0;
        e = e * r + 1.0 / 6.0;
        e = e * r + 0.5;
        e = r + e * r * r;
        memcpy(&bits, &shifted, sizeof bits); /* 2^k: k stands in the last digits */
        bits = (bits + 1023) << 52;
        memcpy(&power, &bits, sizeof power);
        e = power * e + (power - 1.0);
        x[i] = copysign(e / (e + 2.0), x[i]);
    }
}

static inline void remember(double memory[STOPS + 3], double q)
{
    double *last = memory + STOPS, *lowest = last + 1, *highest = last + 2;
    if (isnan(*last)) {
        *last = *lowest = *highest = q;
    }
    const double step = q - *last;
    *last = q;
    *lowest = q < *lowest ? q : *lowest;
    *highest = q > *highest ? q : *highest;
    for (int i = 0; i < STOPS; ++i) {
        memory[i] = clipped(memory[i] + step / width[i], -1.0, 1.0);
    }
}

/* Write the columns of the links' regressor that are independent, (BASE, N). */
static void fill_rigid(const poses *at, double rigid[BASE][N])
{
    double z[3][POSES], r[3][POSES], y[10][N];
    vec w = {0.0, 0.0, 0.0}, dw = {0.0, 0.0, 0.0}, a = vec_of(base_acceleration);
    memset(rigid, 0, sizeof(double[BASE][N]));
    for (int i = 0, next = 0; i < N; ++i) {
        const vec p = vec_of(translation[i]), u = vec_of(axis[i]);
        const rotation R = joint_rotation(i, at->c[i][0], at->s[i][0]);
        a = to_child(R, add(a, add(cross(dw, p), cross(w, cross(w, p)))));
        w = to_child(R, w);
        const vec rate = scaled(u, at->v[i][0]);
        dw = add(to_child(R, dw), add(scaled(u, at->a[i][0]), cross(w, rate)));
        w = add(w, rate);
        for (int j = 0; j < i; ++j) {
            put(r, j, to_child(R, add(lane(r, j), p)));
            put(z, j, to_child(R, lane(z, j)));
        }
        put(z, i, u);
        put(r, i, (vec){0.0, 0.0, 0.0});
        for (int j = 0; j <= i; ++j) {
            const vec Z = lane(z, j), arm = cross(Z, lane(r, j)), turn = cross(Z, w);
            const vec pull = add(scaled(w, dot(arm, w)), scaled(arm, -dot(w, w)));
            const vec h = add(cross(a, Z), add(cross(arm, dw), pull));
            y[0][j] = dot(arm, a);
            y[1][j] = h.x;
            y[2][j] = h.y;
            y[3][j] = h.z;
            y[4][j] = Z.x * dw.x + turn.x * w.x;
            y[5][j] = Z.x * dw.y + Z.y * dw.x + turn.x * w.y + turn.y * w.x;
            y[6][j] = Z.y * dw.y + turn.y * w.y;
            y[7][j] = Z.x * dw.z + Z.z * dw.x + turn.x * w.z + turn.z * w.x;
            y[8][j] = Z.y * dw.z + Z.z * dw.y + turn.y * w.z + turn.z * w.y;
            y[9][j] = Z.z * dw.z + turn.z * w.z;
        }
        for (; next < BASE && base[next] / 10 == i; ++next) {
            for (int j = 0; j <= i; ++j) {
                rigid[next][j] = y[base[next] % 10][j];
            }
        }
    }
}

/* Write the columns of a joint but those of friction, (OTHERS,). */
static void fill_others(int j, const double rigid[BASE][N], double v, double a,
                        const double wave[2 * HARMONICS], const double load[N],
                        const double slope[N][N], const double torque[N], double x[WHOLE])
{
    for (int i = 0; i < BASE; ++i) {
        *x++ = rigid[i][j];
    }
    *x++ = a;
    *x++ = 1.0;
    for (int m = 0; m < N; ++m) {
        x[m] = torque[m];
        x[N + m] = slope[m][j];
        x[2 * N + m] = slope[m][j] * load[m];
    }
    x += 3 * N;
    *x++ = v * fabs(v);
    *x++ = copysign(sqrt(fabs(v)), v);
    memcpy(x, wave, 2 * HARMONICS * sizeof *x);
}

/* Write sines and cosines of an angle and its multiples. */
static inline void fill_waves(double c, double s, double wave[2 * HARMONICS])
{
    wave[0] = s;
    wave[1] = c;
    for (int i = 2; i < 2 * HARMONICS; i += 2) {
        wave[i] = wave[i - 2] * c + wave[i - 1] * s;
        wave[i + 1] = wave[i - 1] * c - wave[i - 2] * s;
    }
}

/* Write the terms of friction: each state, less the next, with the factor of each family. */
static void fill_friction(const double states[STATES + 1], const double factor[FAMILIES],
                          float seen[WIDEST])
{
    for (int i = 0; i <= STATES; ++i, seen += FAMILIES) {
        const int own = order[i];
        double z = states[own];
        if (next[own] != own) {
            const double change = z - states[next[own]];
            z = fabs(change) > NOTHING_BETWEEN * fabs(z) ? change : 0.0;
        }
        for (int k = 0; k < FAMILIES; ++k) {
            seen[k] = (float)(factor[k] * z);
        }
    }
}

/* Return |R x|^2. R is lower triangular and stands in groups of columns, each from the vector of the
 * group's first row down; rows and columns are filled up with zeros. Most often, half of x is zero. */
AS_WRITTEN static double leverage_of(const float *restrict x, const float *restrict R, int rows)
{
#ifdef __clang__
#pragma STDC FP_CONTRACT OFF
#endif
    _Alignas(4 * LANES) float y[WIDEST] = {0.0F};
    const int end = (rows + LANES - 1) / LANES * LANES;
    double sum[LANES] = {0.0}, total = 0.0;
    for (int k = 0; k < rows; k += FAMILIES) {
        const int top = (end - rows + k) / LANES * LANES;
        const float x0 = x[k], x1 = x[k + 1], x2 = x[k + 2], x3 = x[k + 3], x4 = x[k + 4],
                    x5 = x[k + 5];
        if (x0 == 0.0F && x1 == 0.0F && x2 == 0.0F && x3 == 0.0F && x4 == 0.0F && x5 == 0.0F) {
            R += FAMILIES * (end - top);
            continue;
        }
        for (int i = top; i < end; i += LANES, R += FAMILIES * LANES) {
            for (int l = 0; l < LANES; ++l) {
                y[i + l] += ((R[l] * x0 + R[LANES + l] * x1) +
                             (R[2 * LANES + l] * x2 + R[3 * LANES + l] * x3)) +
                            (R[4 * LANES + l] * x4 + R[5 * LANES + l] * x5);
            }
        }
    }
    for (int i = 0; i < end; i += LANES) {
        for (int l = 0; l < LANES; ++l) {
            sum[l] += (double)y[i + l] * (double)y[i + l];
        }
    }
    for (int l = 0; l < LANES; ++l) {
        total += sum[l];
    }
    return total;
}

/* Several sums side by side, since each addition waits for the one before. */
static double product(const double a[WHOLE], const double b[WHOLE])
{
    double sum[LANES] = {0.0}, total = 0.0;
    for (int i = 0; i < WHOLE; i += LANES) {
        for (int l = 0; l < LANES; ++l) {
            sum[l] += a[i + l] * b[i + l];
        }
    }
    for (int l = 0; l < LANES; ++l) {
        total += sum[l];
    }
    return total;
}

static inline double cube(double x)
{
    return x * x * x;
}

/* Return the variance of what nobody knows of the stops before the joint turned. */
static double forgotten(int j, const double factor[FAMILIES], double range)
{
    double u[STOPS], total = 0.0;
    int first = 0;
    while (first < STOPS && range >= 2.0 * width[first]) {
        ++first;
    }
    for (int i = first; i < STOPS; ++i) {
        const double r = range / width[i];
        double h = 0.0;
        for (int k = 0; k < FAMILIES; ++k) {
            h += factor[k] * height[j][k][i];
        }
        u[i] = h * (r >= 1.0 ? sqrt(0.5 * cube(2.0 - r))
                             : sqrt(0.5 * (cube(1.0 - r) + 1.0) + 1.5 * r * (1.0 - r) * (1.0 - r)));
    }
    for (int i = first; i < STOPS; ++i) {
        for (int k = first; k < STOPS; ++k) {
            total += u[i] * moment[j][i][k] * u[k];
        }
    }
    return fmax(total, 0.0);
}

/* Pick columns; vectors that gather are slower than plain loads. */
ONE_BY_ONE static void pick(const double x[WHOLE], const int *columns, int count, float *seen)
{
    for (int k = 0; k < count; ++k) {
        seen[k] = (float)x[columns[k]];
    }
}

/* Return what was learned of friction: the sum over families of factor times weights times states. */
static double friction_of(const double weights[STATES + 1][FAMILIES],
                          const double states[STATES + 1], const double factor[FAMILIES])
{
    double sum[FAMILIES] = {0.0}, total = 0.0;
    for (int i = 0; i <= STATES; ++i) {
        for (int k = 0; k < FAMILIES; ++k) {
            sum[k] += weights[i][k] * states[i];
        }
    }
    for (int k = 0; k < FAMILIES; ++k) {
        total += factor[k] * sum[k];
    }
    return total;
}

/* Write the directions of all joints, smoothed over speeds and over a step of the filter. */
static void fill_directions(const double v[N], const double a[N],
                            double directions[N][SPEEDS + SHARPS])
{
    double x[DIRECTIONS] = {0.0};
    for (int j = 0; j < N; ++j) {
        double *own = x + (SPEEDS + SHARPS) * j;
        const double change = STEP_TIME * a[j];
        for (int i = 0; i < SPEEDS; ++i) {
            own[i] = v[j] / speed[i];
        }
        for (int i = 0; i < SHARPS; ++i) {
            own[SPEEDS + i] = v[j] / sqrt(sharp[i] * sharp[i] + change * change);
        }
    }
    tanh_of(x);
    memcpy(directions, x, N * sizeof directions[0]);
}

static void learn(limo_memory *memory, const poses *at, const double torque_at[N][POSES],
                  const double q[N], const double v[N], const double a[N],
                  limo_estimate *estimate)
{
    double rigid[BASE][N], slope[N][N], load[N], directions[N][SPEEDS + SHARPS];
    double x[WHOLE] = {0.0};
    float seen[WIDEST] = {0.0F};
    const float *R = root;
    for (int j = 0; j < N; ++j) {
        load[j] = torque_at[j][0];
        for (int m = 0; m < N; ++m) {
            slope[m][j] = (torque_at[j][2 + 2 * m] - torque_at[j][3 + 2 * m]) / (2.0 * DIFFERENCE);
        }
    }
    fill_rigid(at, rigid);
    fill_directions(v, a, directions);
    const int *columns = kept;
    for (int j = 0; j < N; ++j) {
        double *own = memory->joints + (STOPS + 3) * j;
        double states[STATES + 1], wave[2 * HARMONICS], factor[FAMILIES] = {1.0, fabs(load[j])};
        const int others = size[j] - FAMILIES * (STATES + 1);
        remember(own, q[j]);
        memcpy(states, own, STOPS * sizeof *states);
        memcpy(states + STOPS, directions[j], sizeof directions[j]);
        states[STATES] = v[j];
        fill_waves(at->c[j][0], at->s[j][0], wave);
        memcpy(factor + 2, wave, WAVES * sizeof *wave);
        fill_others(j, (const double(*)[N])rigid, v[j], a[j], wave, load,
                    (const double(*)[N])slope, estimate->simulation, x);
        fill_friction(states, factor, seen);
        pick(x, columns, others, seen + FAMILIES * (STATES + 1));
        for (int k = size[j]; k < WIDEST; ++k) {
            seen[k] = 0.0F;
        }
        const double learned =
            product(x, weight[j]) + friction_of(friction_weight[j], states, factor);
        const double range = own[STOPS + 2] - own[STOPS + 1];
        const double leverage = leverage_of(seen, R, size[j]);
        const double unknown = forgotten(j, factor, range);
        estimate->learned[j] = learned / (1.0 + fading[j] * leverage);
        estimate->deviation[j] = sqrt(certain[j] + unsure[j] * leverage + unknown);
        estimate->outside[j] = leverage > farthest[j] || !(range > SETTLED);
        columns += others;
        R += root_size[j];
    }
}
