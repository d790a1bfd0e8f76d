// A client of KUKA's FRI that overlays friction compensation and watches for contacts.
//
// The controller compensates gravity itself; what is commanded on top of it is the friction of the
// commanded motion.
#include <algorithm>

#include "friClientIf.h"
#include "friLBRClient.h"

#include "limo.h"

static_assert(LIMO_JOINTS == KUKA::FRI::LBRState::NUMBER_OF_JOINTS, "the model is of an LBR");
static_assert(LIMO_CONTACT, "export with --free RECORDING, from which contact is known");

class OverlayClient : public KUKA::FRI::LBRClient {
public:
  OverlayClient() {
    limo_init(&state_);
    limo_model_init(&ahead_);
  }

  bool contact() const {
    return std::any_of(estimate_.contact, estimate_.contact + LIMO_JOINTS, [](bool c) { return c; });
  }

  void monitor() override {
    LBRClient::monitor();
    hear();
    begun_ = false;  // commanding begins anew, wherever the arm then is
  }

  void command() override {
    hear();
    double position[LIMO_JOINTS], velocity[LIMO_JOINTS], acceleration[LIMO_JOINTS];
    double torque[LIMO_JOINTS];
    const double period = robotState().getSampleTime();
    for (int j = 0; j < LIMO_JOINTS; ++j) {  // commanded positions are smooth: differences will do
      position[j] = robotState().getIpoJointPosition()[j];
      velocity[j] = begun_ ? (position[j] - position_[j]) / period : 0.0;
      acceleration[j] = begun_ ? (velocity[j] - velocity_[j]) / period : 0.0;
      position_[j] = position[j];
      velocity_[j] = velocity[j];
    }
    if (!begun_) {
      limo_model_init(&ahead_);
    }
    begun_ = true;
    ahead_time_ += period;
    const bool known =
        limo_model_step(&ahead_, ahead_time_, position, velocity, acceleration, &wanted_) == LIMO_OK;
    for (int j = 0; j < LIMO_JOINTS; ++j) {
      torque[j] = known && !contact() ? wanted_.friction[j] : 0.0;
    }
    robotCommand().setJointPosition(position);
    if (robotState().getClientCommandMode() == KUKA::FRI::TORQUE) {
      robotCommand().setTorque(torque);
    }
  }

private:
  // A state that cannot be used leaves estimate and memory as they were.
  void hear() {
    const auto &now = robotState();
    const double time = now.getTimestampSec() + 1e-9 * now.getTimestampNanoSec();
    limo_step(&state_, time, now.getMeasuredJointPosition(), now.getMeasuredTorque(), &estimate_);
  }

  limo_state state_{};   // of what is measured, for contact
  limo_memory ahead_{};  // of what is commanded, for friction
  limo_estimate estimate_{}, wanted_{};
  double position_[LIMO_JOINTS]{}, velocity_[LIMO_JOINTS]{}, ahead_time_ = 0.0;
  bool begun_ = false;
};

int run_overlay(KUKA::FRI::LBRClient *client);

int main() {
  static OverlayClient client;
  return run_overlay(&client);  // your connection and application, as in KUKA's own examples
}
