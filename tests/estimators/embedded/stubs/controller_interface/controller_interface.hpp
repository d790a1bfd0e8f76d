// As much of ros2_control (Jazzy) as the example uses: declarations without a body.
#pragma once
#include <cstdio>
#include <memory>
#include <string>
#include <vector>
namespace rclcpp {
struct Duration {
  static Duration from_seconds(double seconds);
};
struct Time {
  double seconds() const;
  Time operator-(const Duration &) const;
};
struct SystemDefaultsQoS {};
struct Logger {};
struct Parameter {
  std::string as_string() const;
  std::vector<std::string> as_string_array() const;
};
template <class Message> struct Publisher {};
}  // namespace rclcpp
#define RCLCPP_ERROR(logger, ...) (static_cast<void>(logger), std::snprintf(nullptr, 0, __VA_ARGS__))
namespace rclcpp_lifecycle {
struct State {};
struct LifecycleNode {
  rclcpp::Parameter get_parameter(const std::string &name) const;
  rclcpp::Logger get_logger() const;
  template <class Message>
  std::shared_ptr<rclcpp::Publisher<Message>> create_publisher(const std::string &topic,
                                                               const rclcpp::SystemDefaultsQoS &);
};
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
  virtual CallbackReturn on_configure(const rclcpp_lifecycle::State &);
  virtual CallbackReturn on_activate(const rclcpp_lifecycle::State &state) = 0;
  virtual return_type update(const rclcpp::Time &time, const rclcpp::Duration &period) = 0;

  std::shared_ptr<rclcpp_lifecycle::LifecycleNode> get_node() const;

protected:
  template <typename T> T auto_declare(const std::string &name, const T &value);
  std::vector<hardware_interface::LoanedStateInterface> state_interfaces_;
  std::vector<hardware_interface::LoanedCommandInterface> command_interfaces_;
};
}  // namespace controller_interface
