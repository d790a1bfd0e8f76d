// A libfranka loop that holds softly, compensates friction, and stops at a contact.
//
// Franka's drives add gravity themselves, so that torque commands are without it; its measured
// torque is with it, as the model's is.
#include <algorithm>
#include <array>
#include <iostream>

#include <franka/exception.h>
#include <franka/robot.h>

#include "limo.h"

static_assert(LIMO_JOINTS == 7, "the model is of an arm with seven joints");
static_assert(LIMO_CONTACT, "export with --free RECORDING, from which contact is known");

int main(int argc, char **argv) {
  if (argc != 2) {
    std::cerr << "usage: " << argv[0] << " <robot address>\n";
    return 2;
  }
  static limo_state state;  // 50 kB: not on the stack of the loop
  static limo_memory ahead;
  limo_estimate estimate{}, wanted{};
  limo_init(&state);
  limo_model_init(&ahead);
  try {
    franka::Robot robot(argv[1]);
    const std::array<double, 7> hold = robot.readOnce().q, still{};
    double time = 0.0;
    robot.control([&](const franka::RobotState &now, franka::Duration period) -> franka::Torques {
      time += period.toSec();
      std::array<double, 7> torque{};
      // the first call comes with a period of 0, and nothing to say yet
      if (period.toSec() > 0.0 &&
          limo_step(&state, time, now.q.data(), now.tau_J.data(), &estimate) != LIMO_OK) {
        return franka::MotionFinished(franka::Torques(torque));
      }
      limo_model_step(&ahead, time, hold.data(), still.data(), still.data(), &wanted);
      for (std::size_t j = 0; j < 7; ++j) {
        const double pull = 60.0 * (hold[j] - now.q[j]) - 6.0 * now.dq[j];
        torque[j] = wanted.torque[j] - wanted.gravity[j] + pull;
      }
      if (std::any_of(estimate.contact, estimate.contact + 7, [](bool c) { return c; })) {
        return franka::MotionFinished(franka::Torques(torque));
      }
      return franka::Torques(torque);
    });
  } catch (const franka::Exception &error) {
    std::cerr << error.what() << '\n';
    return 1;
  }
  return 0;
}
