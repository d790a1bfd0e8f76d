/* Rigid body: Newton and Euler's recursion in several poses at once, which the compiler puts into
 * the lanes of its vectors. */

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

static inline vec scaled(vec a, double f)
{
    return (vec){a.x * f, a.y * f, a.z * f};
}

static inline vec cross(vec a, vec b)
{
    return (vec){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

static inline double dot(vec a, vec b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

/* Columns of a rotation, child to parent. */
typedef struct {
    vec x, y, z;
} rotation;

static inline rotation joint_rotation(int i, double c, double s)
{
    const double *A = still[i], *B = cosine[i], *C = sine[i];
    return (rotation){
        {A[0] + c * B[0] + s * C[0], A[3] + c * B[3] + s * C[3], A[6] + c * B[6] + s * C[6]},
        {A[1] + c * B[1] + s * C[1], A[4] + c * B[4] + s * C[4], A[7] + c * B[7] + s * C[7]},
        {A[2] + c * B[2] + s * C[2], A[5] + c * B[5] + s * C[5], A[8] + c * B[8] + s * C[8]},
    };
}

static inline vec to_child(rotation R, vec a)
{
    return (vec){dot(R.x, a), dot(R.y, a), dot(R.z, a)};
}

static inline vec to_parent(rotation R, vec a)
{
    return add(add(scaled(R.x, a.x), scaled(R.y, a.y)), scaled(R.z, a.z));
}

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
    for (int i = 0; i < N; ++i) {
        const vec p = vec_of(translation[i]), u = vec_of(axis[i]), mc = vec_of(link[i] + 1);
        for (int l = 0; l < count; ++l) {
            const rotation R = joint_rotation(i, at->c[i][l], at->s[i][l]);
            const vec w0 = lane(w, l), dw0 = lane(dw, l);
            const vec swung = add(cross(dw0, p), cross(w0, cross(w0, p)));
            const vec a1 = to_child(R, add(lane(a, l), swung)), w1 = to_child(R, w0);
            const vec rate = scaled(u, at->v[i][l]);
            const vec dw1 = add(to_child(R, dw0), add(scaled(u, at->a[i][l]), cross(w1, rate)));
            const vec w2 = add(w1, rate);
            put(a, l, a1);
            put(dw, l, dw1);
            put(w, l, w2);
            const vec swing = add(cross(dw1, mc), cross(w2, cross(w2, mc)));
            const vec turning = add(turned(link[i] + 4, dw1), cross(w2, turned(link[i] + 4, w2)));
            put(f[i], l, add(scaled(a1, link[i][0]), swing));
            put(m[i], l, add(turning, cross(mc, a1)));
        }
    }
    for (int i = N - 1; i >= 0; --i) {
        const vec p = vec_of(translation[i]), u = vec_of(axis[i]);
        for (int l = 0; l < count; ++l) {
            torque[i][l] = dot(u, lane(m[i], l));
        }
        for (int l = 0; i > 0 && l < count; ++l) {
            const rotation R = joint_rotation(i, at->c[i][l], at->s[i][l]);
            const vec force = to_parent(R, lane(f[i], l)), moment = to_parent(R, lane(m[i], l));
            put(f[i - 1], l, add(lane(f[i - 1], l), force));
            put(m[i - 1], l, add(lane(m[i - 1], l), add(moment, cross(p, force))));
        }
    }
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
