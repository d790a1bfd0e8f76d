// As much of inverse_dynamics_solver as an implementation uses.
#pragma once
#include <stdexcept>
namespace inverse_dynamics_solver {
using InvalidParameterValueException = std::runtime_error;
}
