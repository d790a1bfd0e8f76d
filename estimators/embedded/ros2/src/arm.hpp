// The arm that the model is of: its joints, where its wrench frame is, and the wrench there.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <string>
#include <vector>

#include "limo.h"

namespace limo_dynamics {

@tables@
using Torques = std::array<double, LIMO_JOINTS>;
using Wrench = std::array<double, 6>;  // force [N], then torque [N m]

inline std::string listed(const std::vector<std::string> &names) {
  std::string text;
  for (const auto &name : names) {
    text += (text.empty() ? "" : ", ") + name;
  }
  return text;
}

// Why these are not the joints of the model, in its order; empty where they are.
inline std::string unlike(const std::vector<std::string> &joints) {
  if (joints == joint_names()) {
    return "";
  }
  return "the joints are " + listed(joints) + ", and the model is of " + listed(joint_names());
}

namespace detail {

using Vector = std::array<double, 3>;
using Matrix = std::array<Vector, 3>;

inline Vector times(const Matrix &m, const double v[3]) {
  Vector out{};
  for (int r = 0; r < 3; ++r) {
    out[r] = m[r][0] * v[0] + m[r][1] * v[1] + m[r][2] * v[2];
  }
  return out;
}

inline Matrix times(const Matrix &a, const double b[3][3]) {
  Matrix out{};
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) {
      out[r][c] = a[r][0] * b[0][c] + a[r][1] * b[1][c] + a[r][2] * b[2][c];
    }
  }
  return out;
}

// A turn by q about a unit vector.
inline void turn(const double u[3], double q, double out[3][3]) {
  const double s = std::sin(q), c = std::cos(q);
  const double skew[3][3] = {{0.0, -u[2], u[1]}, {u[2], 0.0, -u[0]}, {-u[1], u[0], 0.0}};
  for (int r = 0; r < 3; ++r) {
    for (int k = 0; k < 3; ++k) {
      out[r][k] = (r == k ? c : 0.0) + (1.0 - c) * u[r] * u[k] + s * skew[r][k];
    }
  }
}

// The Jacobian of the frame in its own axes, a row for each joint.
inline std::array<Wrench, LIMO_JOINTS> jacobian(const Torques &position) {
  std::array<Vector, LIMO_JOINTS> axes{}, origins{};
  Matrix at{{{1.0, 0.0, 0.0}, {0.0, 1.0, 0.0}, {0.0, 0.0, 1.0}}};
  Vector p{};
  double turned[3][3];
  for (int j = 0; j < LIMO_JOINTS; ++j) {
    const Vector step = times(at, joint_place[j]);
    turn(joint_axis[j], position[j], turned);
    at = times(times(at, joint_turn[j]), turned);
    for (int k = 0; k < 3; ++k) {
      p[k] += step[k];
    }
    origins[j] = p;
    axes[j] = times(at, joint_axis[j]);
  }
  const Vector step = times(at, frame_place);
  at = times(at, frame_turn);
  std::array<Wrench, LIMO_JOINTS> rows{};
  for (int j = 0; j < LIMO_JOINTS; ++j) {
    const Vector &a = axes[j];
    Vector r{};
    for (int k = 0; k < 3; ++k) {
      r[k] = p[k] + step[k] - origins[j][k];
    }
    const Vector v{a[1] * r[2] - a[2] * r[1], a[2] * r[0] - a[0] * r[2], a[0] * r[1] - a[1] * r[0]};
    for (int k = 0; k < 3; ++k) {
      for (int i = 0; i < 3; ++i) {
        rows[j][k] += at[i][k] * v[i];
        rows[j][3 + k] += at[i][k] * a[i];
      }
    }
  }
  return rows;
}

}  // namespace detail

// What the environment exerts on the arm, in the axes of the frame and about its origin:
// F = -(J S^-1 J^T + P^-1)^-1 J S^-1 external, with S of the deviations, and 1 kN and 1 kN m in P.
inline Wrench wrench_of(const Torques &position, const double external[LIMO_JOINTS],
                        const double deviation[LIMO_JOINTS]) {
  const auto rows = detail::jacobian(position);
  const bool known = std::all_of(deviation, deviation + LIMO_JOINTS, [](double d) { return d > 0.0; });
  double A[6][6] = {};
  Wrench b{};
  for (int j = 0; j < LIMO_JOINTS; ++j) {
    const double weight = known ? 1.0 / (deviation[j] * deviation[j]) : 1.0;
    for (int r = 0; r < 6; ++r) {
      b[r] -= weight * rows[j][r] * external[j];
      for (int c = 0; c < 6; ++c) {
        A[r][c] += weight * rows[j][r] * rows[j][c];
      }
    }
  }
  for (int r = 0; r < 6; ++r) {  // Cholesky: A is positive definite by its prior
    A[r][r] += 1e-6;
  }
  for (int r = 0; r < 6; ++r) {
    for (int c = 0; c <= r; ++c) {
      for (int k = 0; k < c; ++k) {
        A[r][c] -= A[r][k] * A[c][k];
      }
      A[r][c] = r == c ? std::sqrt(A[r][r]) : A[r][c] / A[c][c];
    }
  }
  for (int r = 0; r < 6; ++r) {
    for (int k = 0; k < r; ++k) {
      b[r] -= A[r][k] * b[k];
    }
    b[r] /= A[r][r];
  }
  for (int r = 5; r >= 0; --r) {
    for (int k = r + 1; k < 6; ++k) {
      b[r] -= A[k][r] * b[k];
    }
    b[r] /= A[r][r];
  }
  return b;
}

}  // namespace limo_dynamics
