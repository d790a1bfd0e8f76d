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

/* A quantity of each joint, side by side, with zeros after the last. */
typedef double lanes[LIMO_LANES];

/* In place of fmin and fmax, which are calls, and keep what is around them from vectors. */
static inline double clipped(double x, double lowest, double highest)
{
    return x < lowest ? lowest : x > highest ? highest : x;
}

/* Replace each x by tanh(x): e / (e + 2) with e = exp(2 |x|) - 1, of all at once, in vectors. */
static void tanh_of(double x[DIRECTIONS * LIMO_LANES])
{
    static const double log2_high = 0x1.62e42fee00000p-1, log2_low = 0x1.a39ef35793c76p-33;
    for (int i = 0; i < DIRECTIONS * LIMO_LANES; ++i) {
        const double y = clipped(2.0 * fabs(x[i]), 0.0, 44.0); /* beyond, it is 1 */
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

/* Memory: stops; last, lowest and highest position. */
static void remember(lanes memory[STOPS + 3], const double q[N])
{
    double *last = memory[STOPS], *lowest = memory[STOPS + 1], *highest = memory[STOPS + 2];
    lanes step = {0.0};
    for (int j = 0; j < N; ++j) {
        if (isnan(last[j])) {
            last[j] = lowest[j] = highest[j] = q[j];
        }
        step[j] = q[j] - last[j];
        last[j] = q[j];
        lowest[j] = q[j] < lowest[j] ? q[j] : lowest[j];
        highest[j] = q[j] > highest[j] ? q[j] : highest[j];
    }
    for (int i = 0; i < STOPS; ++i) {
        for (int l = 0; l < LIMO_LANES; ++l) {
            memory[i][l] = clipped(memory[i][l] + step[l] / width[i], -1.0, 1.0);
        }
    }
}

/* Write the directions of the joints, smoothed over speeds and over a step of the filter. */
static void fill_directions(const double v[N], const double a[N], lanes x[DIRECTIONS])
{
    lanes now = {0.0}, change = {0.0};
    for (int j = 0; j < N; ++j) {
        now[j] = v[j];
        change[j] = STEP_TIME * a[j];
    }
    for (int l = 0; l < LIMO_LANES; ++l) {
        for (int i = 0; i < SPEEDS; ++i) {
            x[i][l] = now[l] / speed[i];
        }
        for (int i = 0; i < SHARPS; ++i) {
            x[SPEEDS + i][l] = now[l] / sqrt(sharp[i] * sharp[i] + change[l] * change[l]);
        }
    }
    tanh_of(x[0]);
}

static inline double dot(vec a, vec b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

/* Write the columns of a link's regressor that are independent, from the next one on: what its
 * motion (a, w, dw) takes of joints with axes z, from whose origins it is at r. Return the next. */
static int fill_link(int i, int next, const lanes z[3], const lanes r[3], vec a, vec w, vec dw,
                     lanes x[OTHERS])
{
    lanes y[10];
    for (int l = 0; l < LIMO_LANES; ++l) {
        const vec Z = {z[0][l], z[1][l], z[2][l]}, from = {r[0][l], r[1][l], r[2][l]};
        const vec arm = cross(Z, from);
        const vec turn = cross(Z, w), pull = add(scaled(w, dot(arm, w)), scaled(arm, -dot(w, w)));
        const vec h = add(cross(a, Z), add(cross(arm, dw), pull));
        y[0][l] = dot(arm, a);
        y[1][l] = h.x;
        y[2][l] = h.y;
        y[3][l] = h.z;
        y[4][l] = Z.x * dw.x + turn.x * w.x;
        y[5][l] = Z.x * dw.y + Z.y * dw.x + turn.x * w.y + turn.y * w.x;
        y[6][l] = Z.y * dw.y + turn.y * w.y;
        y[7][l] = Z.x * dw.z + Z.z * dw.x + turn.x * w.z + turn.z * w.x;
        y[8][l] = Z.y * dw.z + Z.z * dw.y + turn.y * w.z + turn.z * w.y;
        y[9][l] = Z.z * dw.z + turn.z * w.z;
    }
    for (; next < BASE && base[next] / 10 == i; ++next) {
        memcpy(x[next], y[base[next] % 10], sizeof x[next]);
    }
    return next;
}

/* Write the columns of the links' regressor. */
static void fill_rigid(const poses *at, lanes x[OTHERS])
{
    lanes z[3] = {{0.0}}, r[3] = {{0.0}};
    vec w = {0.0, 0.0, 0.0}, dw = {0.0, 0.0, 0.0}, a = vec_of(base_acceleration);
    int next = 0;
/*: outward */
    {
        const double c = at->c[@][0], s = at->s[@][0], v = at->v[@][0];
        a = to_child_@(c, s, add(a, add(across_@(dw), cross(w, across_@(w)))));
        w = to_child_@(c, s, w);
        dw = driven_@(to_child_@(c, s, dw), w, v, at->a[@][0]);
        w = turning_@(w, v);
        for (int l = 0; l < LIMO_LANES; ++l) {
            const vec R = to_child_@(c, s, beyond_@((vec){r[0][l], r[1][l], r[2][l]}));
            const vec Z = to_child_@(c, s, (vec){z[0][l], z[1][l], z[2][l]});
            r[0][l] = R.x, r[1][l] = R.y, r[2][l] = R.z;
            z[0][l] = Z.x, z[1][l] = Z.y, z[2][l] = Z.z;
        }
        const vec u = turning_@((vec){0.0, 0.0, 0.0}, 1.0);
        r[0][@] = r[1][@] = r[2][@] = 0.0;
        z[0][@] = u.x, z[1][@] = u.y, z[2][@] = u.z;
        next = fill_link(@, next, (const lanes *)z, (const lanes *)r, a, w, dw, x);
    }
/*: end */
}

/* Write sines and cosines of the angles and their multiples. */
static void fill_waves(const poses *at, lanes wave[2 * HARMONICS])
{
    for (int j = 0; j < LIMO_LANES; ++j) {
        wave[0][j] = j < N ? at->s[j][0] : 0.0;
        wave[1][j] = j < N ? at->c[j][0] : 0.0;
    }
    for (int i = 2; i < 2 * HARMONICS; i += 2) {
        for (int l = 0; l < LIMO_LANES; ++l) {
            wave[i][l] = wave[i - 2][l] * wave[1][l] + wave[i - 1][l] * wave[0][l];
            wave[i + 1][l] = wave[i - 1][l] * wave[1][l] - wave[i - 2][l] * wave[0][l];
        }
    }
}

/* Write the columns of all joints but those of friction. */
static void fill_others(const poses *at, const double torque_at[N][POSES],
                        const double simulated[N], lanes x[OTHERS])
{
    lanes *own = x + BASE;
    fill_rigid(at, x);
    memset(own, 0, (OTHERS - BASE) * sizeof *own);
    for (int j = 0; j < N; ++j) {
        const double v = clipped(at->v[j][0], -fastest[j], fastest[j]);
        own[0][j] = at->a[j][0];
        own[1][j] = 1.0;
        own[2 + 3 * N][j] = v * fabs(v);
        own[3 + 3 * N][j] = copysign(sqrt(fabs(v)), v);
    }
    for (int m = 0; m < N; ++m) {
        const double *ahead = torque_at[0] + 2 + 2 * m;
        double *same = own[2 + m], *slope = own[2 + N + m], *loaded = own[2 + 2 * N + m];
        for (int j = 0; j < N; ++j, ahead += POSES) {
            same[j] = simulated[m];
            slope[j] = (ahead[0] - ahead[1]) * (0.5 / DIFFERENCE);
            loaded[j] = slope[j] * torque_at[m][0];
        }
    }
    fill_waves(at, own + 4 + 3 * N);
}

/* Write the states of friction, each less the next. */
static void fill_terms(const lanes states[STATES + 1], lanes terms[STATES + 1])
{
    for (int i = 0; i <= STATES; ++i) {
        const double *own = states[order[i]], *after = states[next[order[i]]];
        if (own == after) {
            memcpy(terms[i], own, sizeof terms[i]);
            continue;
        }
        for (int l = 0; l < LIMO_LANES; ++l) {
            const double change = own[l] - after[l];
            terms[i][l] = fabs(change) > NOTHING_BETWEEN * fabs(own[l]) ? change : 0.0;
        }
    }
}

/* Write what stands for friction of a joint: each term with the factor of each family. As many are
 * written as fill a vector, and those too many written over. */
static void fill_friction(const lanes terms[STATES + 1], const lanes factors[FAMILIES], int j,
                          float seen[WIDEST])
{
    enum { VECTOR = (FAMILIES + 7) / 8 * 8 };
    double factor[VECTOR] = {0.0};
    for (int k = 0; k < FAMILIES; ++k) {
        factor[k] = factors[k][j];
    }
    for (int i = 0; i <= STATES; ++i, seen += FAMILIES) {
        for (int k = 0; k < VECTOR; ++k) {
            seen[k] = (float)(factor[k] * terms[i][j]);
        }
    }
}

/* Return |R x|^2. R is lower triangular and stands in groups of columns, each from the vector of
 * the group's first row down; rows and columns are filled up with zeros, and x is half zeros. */
AS_WRITTEN static double leverage_of(const float *restrict x, const float *restrict R, int rows)
{
#ifdef __clang__
#pragma STDC FP_CONTRACT OFF
#endif
    _Alignas(4 * LANES) float y[WIDEST] = {0.0F};
    const int end = (rows + LANES - 1) / LANES * LANES;
    double sum[LANES] = {0.0};
    for (int k = 0; k < rows; k += FAMILIES) {
        const int top = (end - rows + k) / LANES * LANES;
        if (k < FAMILIES * (STATES + 1) && x[k] == 0.0F) { /* of all families: its factor is 1 */
            R += FAMILIES * (end - top);
            continue;
        }
        const float x0 = x[k], x1 = x[k + 1], x2 = x[k + 2], x3 = x[k + 3], x4 = x[k + 4],
                    x5 = x[k + 5];
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
    for (int half = LANES / 2; half > 0; half /= 2) {
        for (int l = 0; l < half; ++l) {
            sum[l] += sum[l + half];
        }
    }
    return sum[0];
}

/* Write what was learned of all columns but those of friction. Several sums side by side, since
 * each addition waits for the one before. */
static void weigh(const lanes x[OTHERS], lanes learned)
{
    enum { SUMS = 4 };
    lanes sum[SUMS] = {{0.0}};
    int i = 0;
    for (; i + SUMS <= OTHERS; i += SUMS) {
        for (int k = 0; k < SUMS; ++k) {
            for (int l = 0; l < LIMO_LANES; ++l) {
                sum[k][l] += x[i + k][l] * weight[i + k][l];
            }
        }
    }
    for (; i < OTHERS; ++i) {
        for (int l = 0; l < LIMO_LANES; ++l) {
            sum[0][l] += x[i][l] * weight[i][l];
        }
    }
    for (int l = 0; l < LIMO_LANES; ++l) {
        learned[l] = (sum[0][l] + sum[1][l]) + (sum[2][l] + sum[3][l]);
    }
}

static inline double cube(double x)
{
    return x * x * x;
}

/* Write the variance of what nobody knows of the stops before the joints turned, who have turned in
 * these ranges since. The narrow stops of all joints are known soon. */
static void fill_forgotten(const lanes factor[FAMILIES], const lanes range, lanes variance)
{
    lanes u[STOPS], total = {0.0};
    double least = range[0];
    int first = STOPS;
    for (int j = 1; j < N; ++j) {
        least = range[j] < least ? range[j] : least;
    }
    while (first > 0 && least < 2.0 * width[first - 1]) {
        --first;
    }
    for (int i = first; i < STOPS; ++i) {
        for (int l = 0; l < LIMO_LANES; ++l) {
            const double r = clipped(range[l] / width[i], 0.0, 2.0), rest = 1.0 - r;
            const double near = 0.5 * (cube(rest) + 1.0) + 1.5 * r * rest * rest;
            double h = 0.0;
            for (int k = 0; k < FAMILIES; ++k) {
                h += factor[k][l] * height[i][k][l];
            }
            u[i][l] = h * sqrt(r >= 1.0 ? 0.5 * cube(2.0 - r) : near);
        }
    }
    for (int i = first; i < STOPS; ++i) {
        for (int k = first; k < STOPS; ++k) {
            for (int l = 0; l < LIMO_LANES; ++l) {
                total[l] += u[i][l] * moment[i][k][l] * u[k][l];
            }
        }
    }
    for (int l = 0; l < LIMO_LANES; ++l) {
        variance[l] = total[l] > 0.0 ? total[l] : 0.0;
    }
}

/* Pick columns of a joint; vectors that gather are slower than plain loads. */
ONE_BY_ONE static void pick(const lanes x[OTHERS], int j, const int *columns, int count,
                            float *seen)
{
    for (int k = 0; k < count; ++k) {
        seen[k] = (float)x[columns[k]][j];
    }
}

/* Add what was learned of friction: over families, factor times weights times states. */
static void weigh_friction(const lanes states[STATES + 1], const lanes factor[FAMILIES],
                           lanes learned)
{
    lanes sum[FAMILIES] = {{0.0}};
    for (int i = 0; i <= STATES; ++i) {
        for (int k = 0; k < FAMILIES; ++k) {
            for (int l = 0; l < LIMO_LANES; ++l) {
                sum[k][l] += friction_weight[i][k][l] * states[i][l];
            }
        }
    }
    for (int k = 0; k < FAMILIES; ++k) {
        for (int l = 0; l < LIMO_LANES; ++l) {
            learned[l] += factor[k][l] * sum[k][l];
        }
    }
}

static void learn(limo_memory *memory, const poses *at, const double torque_at[N][POSES],
                  const double q[N], const double v[N], const double a[N],
                  limo_estimate *estimate)
{
    lanes x[OTHERS], states[STATES + 1] = {{0.0}}, terms[STATES + 1], factor[FAMILIES] = {{0.0}};
    lanes learned, range, unknown, *own = (lanes *)memory->joints;
    float seen[WIDEST];
    const float *R = root;
    const int *columns = kept;
    fill_others(at, torque_at, estimate->simulation, x);
    remember(own, q);
    memcpy(states, own, STOPS * sizeof *states);
    fill_directions(v, a, states + STOPS);
    for (int j = 0; j < N; ++j) {
        states[STATES][j] = clipped(v[j], -fastest[j], fastest[j]);
        factor[0][j] = 1.0;
        factor[1][j] = fabs(torque_at[j][0]);
    }
    memcpy(factor + 2, x + OTHERS - 2 * HARMONICS, WAVES * sizeof *factor);
    weigh((const lanes *)x, learned);
    weigh_friction((const lanes *)states, (const lanes *)factor, learned);
    fill_terms((const lanes *)states, terms);
    for (int l = 0; l < LIMO_LANES; ++l) {
        range[l] = own[STOPS + 2][l] - own[STOPS + 1][l];
    }
    fill_forgotten((const lanes *)factor, range, unknown);
    for (int j = 0; j < N; ++j) {
        const int others = size[j] - FAMILIES * (STATES + 1);
        fill_friction((const lanes *)terms, (const lanes *)factor, j, seen);
        pick((const lanes *)x, j, columns, others, seen + FAMILIES * (STATES + 1));
        for (int k = 0; k < FAMILIES; ++k) { /* the last group is full */
            seen[size[j] + k] = 0.0F;
        }
        const double far = leverage_of(seen, R, size[j]), faded = fading[0][j] + fading[1][j] * far;
        const double faster = fmax(fabs(v[j]) / fastest[j] - 1.0, 0.0);
        unknown[j] += usual[j] * faster * faster;
        estimate->learned[j] = learned[j] / (1.0 + faded * far);
        estimate->deviation[j] = sqrt(certain[j] + unsure[j] * far + unknown[j]);
        estimate->outside[j] = far > farthest[j] || !(range[j] > SETTLED) || faster > FASTER;
        columns += others;
        R += root_size[j];
    }
}
