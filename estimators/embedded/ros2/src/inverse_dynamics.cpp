// inverse_dynamics_solver's interface over the model. Its interface has no memory, so each call asks
// the model anew: what depends on the motion before, as hysteresis does, is in `getFrictionVector`
// as after a long motion at the velocity, and nowhere else.
#include <inverse_dynamics_solver/exceptions.h>
#include <inverse_dynamics_solver/inverse_dynamics_solver.h>

#include <pluginlib/class_list_macros.hpp>

#include "arm.hpp"

namespace limo_dynamics {

class InverseDynamics : public inverse_dynamics_solver::InverseDynamicsSolver {
public:
  using Vector = Eigen::VectorXd;

  void initialize(rclcpp::node_interfaces::NodeParametersInterface::ConstSharedPtr = nullptr,
                  const std::string & = "", const std::string &robot_description = "") override {
    for (const auto &joint : joint_names()) {
      if (!robot_description.empty() && robot_description.find(joint) == std::string::npos) {
        throw inverse_dynamics_solver::InvalidParameterValueException(
            "robot_description has no joint " + joint + ": the model is of another robot");
      }
    }
  }

  Eigen::MatrixXd getInertiaMatrix(const Vector &position) const override {
    const Vector still = zero(), held = rigid(position, still, still);
    Eigen::MatrixXd matrix(LIMO_JOINTS, LIMO_JOINTS);
    for (int c = 0; c < LIMO_JOINTS; ++c) {
      Vector unit = zero();
      unit[c] = 1.0;
      const Vector column = rigid(position, still, unit);
      for (int r = 0; r < LIMO_JOINTS; ++r) {
        matrix(r, c) = column[r] - held[r];
      }
    }
    return matrix;
  }

  Vector getCoriolisVector(const Vector &position, const Vector &velocity) const override {
    const Vector still = zero(), held = rigid(position, still, still);
    Vector torque = rigid(position, velocity, still);
    for (int j = 0; j < LIMO_JOINTS; ++j) {
      torque[j] -= held[j];
    }
    return torque;
  }

  Vector getGravityVector(const Vector &position) const override {
    return rigid(position, zero(), zero());
  }

  // At the pose of zeros, after half a radian of each joint that moves.
  Vector getFrictionVector(const Vector &velocity) const override {
    check(velocity);
    double fastest = 0.0;
    for (int j = 0; j < LIMO_JOINTS; ++j) {
      fastest = std::max(fastest, std::abs(velocity[j]));
    }
    constexpr int steps = 500;
    constexpr double way = 0.5;  // [rad]
    limo_memory memory;
    limo_model_init(&memory);
    limo_estimate estimate;
    Vector position = zero();
    for (int k = 0; k <= steps; ++k) {
      for (int j = 0; j < LIMO_JOINTS; ++j) {
        const double sign = (velocity[j] > 0.0) - (velocity[j] < 0.0);
        position[j] = sign * way * (k - steps) / steps;
      }
      const double time = fastest > 0.0 ? k * way / steps / fastest : k / LIMO_RATE;
      step(memory, time, position, velocity, zero(), estimate);
    }
    return vector(estimate.friction);
  }

  Vector getTorques(const Vector &position, const Vector &velocity,
                    const Vector &acceleration) const override {
    return rigid(position, velocity, acceleration);
  }

private:
  static Vector zero() {
    const double zeros[LIMO_JOINTS] = {};
    return vector(zeros);
  }

  static Vector vector(const double values[LIMO_JOINTS]) {
    Vector out(LIMO_JOINTS);
    for (int j = 0; j < LIMO_JOINTS; ++j) {
      out[j] = values[j];
    }
    return out;
  }

  static void check(const Vector &values) {
    if (values.size() != LIMO_JOINTS) {
      throw inverse_dynamics_solver::InvalidParameterValueException(
          std::to_string(values.size()) + " values, expected one for each of " + listed(joint_names()));
    }
  }

  static void step(limo_memory &memory, double time, const Vector &position, const Vector &velocity,
                   const Vector &acceleration, limo_estimate &estimate) {
    for (const Vector *values : {&position, &velocity, &acceleration}) {
      check(*values);
    }
    if (limo_model_step(&memory, time, position.data(), velocity.data(), acceleration.data(),
                        &estimate) != LIMO_OK) {
      throw inverse_dynamics_solver::InvalidParameterValueException("a value is not finite");
    }
  }

  // The simulation without friction, and with the payload.
  static Vector rigid(const Vector &position, const Vector &velocity, const Vector &acceleration) {
    limo_memory memory;
    limo_model_init(&memory);
    limo_estimate estimate;
    step(memory, 0.0, position, velocity, acceleration, estimate);
    for (int j = 0; j < LIMO_JOINTS; ++j) {
      estimate.simulation[j] -= estimate.friction[j];
    }
    return vector(estimate.simulation);
  }
};

}  // namespace limo_dynamics

PLUGINLIB_EXPORT_CLASS(limo_dynamics::InverseDynamics, inverse_dynamics_solver::InverseDynamicsSolver)
