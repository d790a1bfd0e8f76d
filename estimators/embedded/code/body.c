/* Rigid body: Newton and Euler's recursion in several poses at once, which the compiler puts into
 * the lanes of its vectors. It is written out joint by joint, without what is zero in the arm. */

typedef struct {
    double x, y, z;
} vec;

static inline vec vec_of(const double x[3])
{
    return (vec){x[0], x[1], x[2]};
}

static inline vec add(vec a, vec b)
{
    return (vec){a.x + b.x, a.y + b.y, a.z + b.z};
}

static inline vec minus(vec a, vec b)
{
    return (vec){a.x - b.x, a.y - b.y, a.z - b.z};
}

static inline vec scaled(vec a, double f)
{
    return (vec){a.x * f, a.y * f, a.z * f};
}

static inline vec cross(vec a, vec b)
{
    return (vec){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

/*: joints */
static inline vec turned(const double I[6], vec a)
{
    return (vec){I[0] * a.x + I[1] * a.y + I[3] * a.z, I[1] * a.x + I[2] * a.y + I[4] * a.z,
                 I[3] * a.x + I[4] * a.y + I[5] * a.z};
}

static inline vec lane(double m[3][POSES], int l)
{
    return (vec){m[0][l], m[1][l], m[2][l]};
}

static inline void put(double m[3][POSES], int l, vec a)
{
    m[0][l] = a.x;
    m[1][l] = a.y;
    m[2][l] = a.z;
}

/* Joint angles by their cosines and sines, velocities and accelerations of several poses. */
typedef struct {
    double c[N][POSES], s[N][POSES], v[N][POSES], a[N][POSES];
} poses;

static inline void inverse_dynamics(const double link[][10], const poses *at, int count,
                                    double torque[N][POSES])
{
    double w[3][POSES], dw[3][POSES], a[3][POSES], f[N][3][POSES], m[N][3][POSES];
    for (int l = 0; l < count; ++l) {
        put(w, l, (vec){0.0, 0.0, 0.0});
        put(dw, l, (vec){0.0, 0.0, 0.0});
        put(a, l, vec_of(base_acceleration));
    }
/*: outward */
    for (int l = 0; l < count; ++l) {
        const double *own = link[@], c = at->c[@][l], s = at->s[@][l], v = at->v[@][l];
        const vec mc = vec_of(own + 1), w0 = lane(w, l), dw0 = lane(dw, l);
        const vec w1 = to_child_@(c, s, w0);
        const vec swung = add(across_@(dw0), cross(w0, across_@(w0)));
        const vec a1 = to_child_@(c, s, add(lane(a, l), swung)), w2 = turning_@(w1, v);
        const vec dw1 = driven_@(to_child_@(c, s, dw0), w1, v, at->a[@][l]);
        const vec swing = add(cross(dw1, mc), cross(w2, cross(w2, mc)));
        const vec turn = add(turned(own + 4, dw1), cross(w2, turned(own + 4, w2)));
        put(a, l, a1);
        put(dw, l, dw1);
        put(w, l, w2);
        put(f[@], l, add(scaled(a1, own[0]), swing));
        put(m[@], l, add(turn, cross(mc, a1)));
    }
/*: end */
/*: inward */
    for (int l = 0; l < count; ++l) {
        const double c = at->c[@][l], s = at->s[@][l];
        const vec force = to_parent_@(c, s, lane(f[@], l));
        const vec moment = minus(to_parent_@(c, s, lane(m[@], l)), across_@(force));
        put(f[@ - 1], l, add(lane(f[@ - 1], l), force));
        put(m[@ - 1], l, add(lane(m[@ - 1], l), moment));
    }
/*: end */
/*: outward */
    for (int l = 0; l < count; ++l) {
        torque[@][l] = along_@(lane(m[@], l));
    }
/*: end */
}

static void pose(poses *at, int l, const double q[N], const double v[N], const double a[N])
{
    for (int j = 0; j < N; ++j) {
        at->c[j][l] = cos(q[j]);
        at->s[j][l] = sin(q[j]);
        at->v[j][l] = v[j];
        at->a[j][l] = a[j];
    }
}
