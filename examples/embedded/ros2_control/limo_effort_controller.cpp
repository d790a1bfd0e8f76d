#include "limo_effort_controller.hpp"

#include <algorithm>

namespace limo {

using controller_interface::CallbackReturn;
using controller_interface::InterfaceConfiguration;
using controller_interface::interface_configuration_type;
using controller_interface::return_type;

namespace {

// Interfaces in the order that `update` reads and writes them: one kind after the other.
std::vector<std::string> named(const std::vector<std::string> &joints,
                               const std::vector<std::string> &kinds) {
  std::vector<std::string> names;
  for (const auto &kind : kinds) {
    for (const auto &joint : joints) {
      names.push_back(joint + "/" + kind);
    }
  }
  return names;
}

}  // namespace

CallbackReturn EffortController::on_init() {
  joints_ = auto_declare<std::vector<std::string>>("joints", {});
  stiffness_ = auto_declare<double>("stiffness", 50.0);  // [N m/rad]
  damping_ = auto_declare<double>("damping", 5.0);       // [N m s/rad]
  return joints_.size() == LIMO_JOINTS ? CallbackReturn::SUCCESS : CallbackReturn::ERROR;
}

InterfaceConfiguration EffortController::command_interface_configuration() const {
  return {interface_configuration_type::INDIVIDUAL, named(joints_, {"effort"})};
}

InterfaceConfiguration EffortController::state_interface_configuration() const {
  return {interface_configuration_type::INDIVIDUAL,
          named(joints_, {"position", "velocity", "effort"})};
}

CallbackReturn EffortController::on_activate(const rclcpp_lifecycle::State &) {
  limo_init(&heard_);
  limo_model_init(&ahead_);
  reference_.fill(0.0);
  for (std::size_t j = 0; j < LIMO_JOINTS; ++j) {
    reference_[j] = state_interfaces_[j].get_value();  // it begins where the arm is
  }
  contact_ = false;
  return CallbackReturn::SUCCESS;
}

return_type EffortController::update(const rclcpp::Time &time, const rclcpp::Duration &) {
  std::array<double, LIMO_JOINTS> q{}, v{}, effort{};
  for (std::size_t j = 0; j < LIMO_JOINTS; ++j) {
    q[j] = state_interfaces_[j].get_value();
    v[j] = state_interfaces_[LIMO_JOINTS + j].get_value();
    effort[j] = state_interfaces_[2 * LIMO_JOINTS + j].get_value();
  }
  const double *wanted_q = reference_.data(), *wanted_v = wanted_q + LIMO_JOINTS;
  const double *wanted_a = wanted_v + LIMO_JOINTS;
  if (limo_step(&heard_, time.seconds(), q.data(), effort.data(), &estimate_) != LIMO_OK ||
      limo_model_step(&ahead_, time.seconds(), wanted_q, wanted_v, wanted_a, &wanted_) != LIMO_OK) {
    return return_type::ERROR;
  }
  contact_ = std::any_of(estimate_.contact, estimate_.contact + LIMO_JOINTS, [](bool c) { return c; });
  for (std::size_t j = 0; j < LIMO_JOINTS; ++j) {
    const double pull = stiffness_ * (wanted_q[j] - q[j]) + damping_ * (wanted_v[j] - v[j]);
    command_interfaces_[j].set_value(wanted_.torque[j] + pull);
  }
  return return_type::OK;
}

}  // namespace limo

#include <pluginlib/class_list_macros.hpp>
PLUGINLIB_EXPORT_CLASS(limo::EffortController, controller_interface::ControllerInterface)
