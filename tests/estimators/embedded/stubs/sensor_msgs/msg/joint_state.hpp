#pragma once
#include <controller_interface/controller_interface.hpp>
namespace std_msgs::msg {
struct Header {
  rclcpp::Time stamp;
  std::string frame_id;
};
}  // namespace std_msgs::msg
namespace sensor_msgs::msg {
struct JointState {
  std_msgs::msg::Header header;
  std::vector<std::string> name;
  std::vector<double> position, velocity, effort;
};
}  // namespace sensor_msgs::msg
