// As much of libfranka (0.13) as the example uses: declarations without a body.
#pragma once
#include <array>
#include <functional>
#include <string>
namespace franka {
struct RobotState {
  std::array<double, 7> q, dq, tau_J;
};
struct Duration {
  double toSec() const noexcept;
};
struct Torques {
  Torques(const std::array<double, 7> &torques) noexcept;
  std::array<double, 7> tau_J;
  bool motion_finished = false;
};
Torques MotionFinished(Torques command) noexcept;
class Robot {
public:
  explicit Robot(const std::string &address);
  RobotState readOnce();
  void control(std::function<Torques(const RobotState &, Duration)> callback);
};
}  // namespace franka
