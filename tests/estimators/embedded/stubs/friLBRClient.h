// As much of KUKA's FRI client SDK (1.15) as the example uses: declarations without a body.
#pragma once
namespace KUKA {
namespace FRI {
enum EClientCommandMode { NO_COMMAND_MODE = 0, POSITION = 1, WRENCH = 2, TORQUE = 3 };
class LBRState {
public:
  enum { NUMBER_OF_JOINTS = 7 };
  double getSampleTime() const;
  unsigned int getTimestampSec() const;
  unsigned int getTimestampNanoSec() const;
  EClientCommandMode getClientCommandMode() const;
  const double *getMeasuredJointPosition() const;
  const double *getMeasuredTorque() const;
  const double *getIpoJointPosition() const;
};
class LBRCommand {
public:
  void setJointPosition(const double *values);
  void setTorque(const double *torques);
};
class LBRClient {
public:
  virtual ~LBRClient() = default;
  virtual void monitor();
  virtual void command();
  const LBRState &robotState() const;
  LBRCommand &robotCommand();
};
}  // namespace FRI
}  // namespace KUKA
