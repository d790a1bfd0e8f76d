// A ros2_control controller without commands: external torques of the model, and the wrench that
// explains them, both LIMO_DELAY late and stamped so.
#include <controller_interface/controller_interface.hpp>
#include <geometry_msgs/msg/wrench_stamped.hpp>
#include <pluginlib/class_list_macros.hpp>
#include <realtime_tools/realtime_publisher.hpp>
#include <sensor_msgs/msg/joint_state.hpp>

#include "arm.hpp"

namespace limo_dynamics {

using controller_interface::CallbackReturn;
using controller_interface::InterfaceConfiguration;
using controller_interface::interface_configuration_type;
using controller_interface::return_type;
using geometry_msgs::msg::WrenchStamped;
using sensor_msgs::msg::JointState;

class WrenchBroadcaster : public controller_interface::ControllerInterface {
public:
  CallbackReturn on_init() override {
    auto_declare<std::vector<std::string>>("joints", joint_names());
    auto_declare<std::string>("frame_id", frame_name());
    return CallbackReturn::SUCCESS;
  }

  CallbackReturn on_configure(const rclcpp_lifecycle::State &) override {
    joints_ = get_node()->get_parameter("joints").as_string_array();
    const std::string why = unlike(joints_);
    if (!why.empty()) {
      RCLCPP_ERROR(get_node()->get_logger(), "%s", why.c_str());
      return CallbackReturn::ERROR;
    }
    const auto quality = rclcpp::SystemDefaultsQoS();
    wrench_ = std::make_unique<realtime_tools::RealtimePublisher<WrenchStamped>>(
        get_node()->create_publisher<WrenchStamped>("~/wrench", quality));
    torque_ = std::make_unique<realtime_tools::RealtimePublisher<JointState>>(
        get_node()->create_publisher<JointState>("~/external_torque", quality));
    wrench_->msg_.header.frame_id = get_node()->get_parameter("frame_id").as_string();
    torque_->msg_.name = joints_;
    torque_->msg_.effort.resize(LIMO_JOINTS);
    late_.assign(static_cast<std::size_t>(std::lround(LIMO_DELAY * LIMO_RATE)) + 1, Torques{});
    return CallbackReturn::SUCCESS;
  }

  InterfaceConfiguration command_interface_configuration() const override {
    return {interface_configuration_type::NONE, {}};
  }

  InterfaceConfiguration state_interface_configuration() const override {
    std::vector<std::string> names;
    for (const char *kind : {"/position", "/effort"}) {
      for (const auto &joint : joints_) {
        names.push_back(joint + kind);
      }
    }
    return {interface_configuration_type::INDIVIDUAL, names};
  }

  CallbackReturn on_activate(const rclcpp_lifecycle::State &) override {
    limo_init(&state_);
    return CallbackReturn::SUCCESS;
  }

  return_type update(const rclcpp::Time &time, const rclcpp::Duration &) override {
    Torques position{}, effort{};
    for (std::size_t j = 0; j < LIMO_JOINTS; ++j) {
      position[j] = state_interfaces_[j].get_value();
      effort[j] = state_interfaces_[LIMO_JOINTS + j].get_value();
    }
    if (limo_step(&state_, time.seconds(), position.data(), effort.data(), &estimate_) != LIMO_OK) {
      return return_type::OK;  // a value that is not finite; the estimate stays as it was
    }
    late_[next_] = position;
    next_ = (next_ + 1) % late_.size();
    if (estimate_.filled) {
      publish(time - rclcpp::Duration::from_seconds(LIMO_DELAY), late_[next_]);
    }
    return return_type::OK;
  }

private:
  void publish(const rclcpp::Time &stamp, const Torques &position) {
    if (torque_->trylock()) {
      torque_->msg_.header.stamp = stamp;
      std::copy_n(estimate_.external, LIMO_JOINTS, torque_->msg_.effort.begin());
      torque_->unlockAndPublish();
    }
    if (wrench_->trylock()) {
      const Wrench found = wrench_of(position, estimate_.external, estimate_.deviation);
      auto &force = wrench_->msg_.wrench.force, &torque = wrench_->msg_.wrench.torque;
      wrench_->msg_.header.stamp = stamp;
      force.x = found[0], force.y = found[1], force.z = found[2];
      torque.x = found[3], torque.y = found[4], torque.z = found[5];
      wrench_->unlockAndPublish();
    }
  }

  std::vector<std::string> joints_;
  std::unique_ptr<realtime_tools::RealtimePublisher<WrenchStamped>> wrench_;
  std::unique_ptr<realtime_tools::RealtimePublisher<JointState>> torque_;
  std::vector<Torques> late_;  // positions of the last LIMO_DELAY
  std::size_t next_ = 0;
  limo_state state_{};
  limo_estimate estimate_{};
};

}  // namespace limo_dynamics

PLUGINLIB_EXPORT_CLASS(limo_dynamics::WrenchBroadcaster, controller_interface::ControllerInterface)
