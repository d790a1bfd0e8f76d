// A ros2_control controller: effort feed-forward from an exported model, and contact.
//
// Desired motion comes in by `~/reference` (positions, velocities, accelerations of all joints in a
// row). Effort commands are the model's torque along it, plus a soft pull towards it. Where measured
// effort is beyond the model by more than the threshold, `contact()` says so.
#pragma once

#include <array>
#include <string>
#include <vector>

#include <controller_interface/controller_interface.hpp>

#include "limo.h"

static_assert(LIMO_CONTACT, "export with --free RECORDING, from which contact is known");

namespace limo {

class EffortController : public controller_interface::ControllerInterface {
public:
  controller_interface::CallbackReturn on_init() override;
  controller_interface::InterfaceConfiguration command_interface_configuration() const override;
  controller_interface::InterfaceConfiguration state_interface_configuration() const override;
  controller_interface::CallbackReturn on_activate(const rclcpp_lifecycle::State &) override;
  controller_interface::return_type update(const rclcpp::Time &, const rclcpp::Duration &) override;

  // From the realtime side of a subscription: where the arm is to be, (3, LIMO_JOINTS) in a row.
  void set_reference(const std::array<double, 3 * LIMO_JOINTS> &reference) { reference_ = reference; }
  bool contact() const { return contact_; }

private:
  std::vector<std::string> joints_;
  std::array<double, 3 * LIMO_JOINTS> reference_{};
  limo_state heard_{};    // of the arm, for external torque
  limo_memory ahead_{};   // of the reference, for feed-forward
  limo_estimate estimate_{}, wanted_{};
  double stiffness_ = 0.0, damping_ = 0.0;
  bool contact_ = false;
};

}  // namespace limo
