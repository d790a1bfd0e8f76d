#pragma once
#include <sensor_msgs/msg/joint_state.hpp>
namespace geometry_msgs::msg {
struct Vector3 {
  double x, y, z;
};
struct Wrench {
  Vector3 force, torque;
};
struct WrenchStamped {
  std_msgs::msg::Header header;
  Wrench wrench;
};
}  // namespace geometry_msgs::msg
