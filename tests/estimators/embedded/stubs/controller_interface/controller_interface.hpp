// As much of ros2_control (Jazzy) as the example uses: declarations without a body.
#pragma once
#include <string>
#include <vector>
namespace rclcpp {
struct Time {
  double seconds() const;
};
struct Duration {};
}  // namespace rclcpp
namespace rclcpp_lifecycle {
struct State {};
}  // namespace rclcpp_lifecycle
namespace hardware_interface {
struct LoanedStateInterface {
  double get_value() const;
};
struct LoanedCommandInterface {
  void set_value(double value);
};
}  // namespace hardware_interface
namespace controller_interface {
enum class CallbackReturn { SUCCESS, FAILURE, ERROR };
enum class return_type { OK, ERROR };
enum class interface_configuration_type { ALL, INDIVIDUAL, NONE };
struct InterfaceConfiguration {
  interface_configuration_type type;
  std::vector<std::string> names;
};
class ControllerInterface {
public:
  virtual ~ControllerInterface() = default;
  virtual CallbackReturn on_init() = 0;
  virtual InterfaceConfiguration command_interface_configuration() const = 0;
  virtual InterfaceConfiguration state_interface_configuration() const = 0;
  virtual CallbackReturn on_activate(const rclcpp_lifecycle::State &state) = 0;
  virtual return_type update(const rclcpp::Time &time, const rclcpp::Duration &period) = 0;

protected:
  template <typename T> T auto_declare(const std::string &name, const T &value);
  std::vector<hardware_interface::LoanedStateInterface> state_interfaces_;
  std::vector<hardware_interface::LoanedCommandInterface> command_interfaces_;
};
}  // namespace controller_interface
