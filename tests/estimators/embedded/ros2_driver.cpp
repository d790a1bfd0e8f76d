// Prints what the solver and the wrench of a package are for what stands on standard input.
#include <cstdio>

#include "inverse_dynamics.cpp"

using Vector = Eigen::VectorXd;

static Vector read() {
  Vector values(LIMO_JOINTS);
  for (double &value : values) {
    if (std::scanf("%lf", &value) != 1) throw 1;
  }
  return values;
}

template <class Values> static void show(const Values &values) {
  for (double value : values) std::printf("%.17g ", value);
  std::printf("\n");
}

int main() {
  const Vector q = read(), v = read(), a = read(), external = read(), deviation = read();
  limo_dynamics::InverseDynamics solver;
  solver.initialize(nullptr, "", "");
  show(solver.getInertiaMatrix(q).values);
  show(solver.getCoriolisVector(q, v));
  show(solver.getGravityVector(q));
  show(solver.getTorques(q, v, a));
  show(solver.getFrictionVector(v));
  limo_dynamics::Torques at{};
  std::copy(q.begin(), q.end(), at.begin());
  show(limo_dynamics::wrench_of(at, external.data(), deviation.data()));
  std::printf("%s\n", limo_dynamics::unlike({"a"}).c_str());
  try {
    solver.initialize(nullptr, "", "<robot/>");
  } catch (const std::runtime_error &error) {
    std::printf("%s\n", error.what());
  }
}
