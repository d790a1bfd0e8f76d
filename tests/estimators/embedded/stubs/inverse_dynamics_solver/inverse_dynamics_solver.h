// The interface of github.com/unisa-acg/inverse-dynamics-solver, with as much of Eigen and rclcpp.
#pragma once
#include <memory>
#include <string>
#include <tuple>
#include <vector>
namespace Eigen {
struct VectorXd : std::vector<double> {
  VectorXd() = default;
  explicit VectorXd(int n) : std::vector<double>(n) {}
};
struct MatrixXd {
  MatrixXd(int r, int c) : columns(c), values(r * c) {}
  double &operator()(int r, int c) { return values[r * columns + c]; }
  int columns;
  std::vector<double> values;
};
}  // namespace Eigen
namespace rclcpp::node_interfaces {
struct NodeParametersInterface {
  using ConstSharedPtr = std::shared_ptr<const NodeParametersInterface>;
};
}  // namespace rclcpp::node_interfaces
namespace inverse_dynamics_solver {
class InverseDynamicsSolver {
public:
  virtual ~InverseDynamicsSolver() {}
  virtual void initialize(rclcpp::node_interfaces::NodeParametersInterface::ConstSharedPtr = nullptr,
                          const std::string & = "", const std::string & = "") = 0;
  virtual Eigen::MatrixXd getInertiaMatrix(const Eigen::VectorXd &) const = 0;
  virtual Eigen::VectorXd getCoriolisVector(const Eigen::VectorXd &, const Eigen::VectorXd &) const = 0;
  virtual Eigen::VectorXd getGravityVector(const Eigen::VectorXd &) const = 0;
  virtual Eigen::VectorXd getFrictionVector(const Eigen::VectorXd &) const = 0;
  virtual Eigen::VectorXd getTorques(const Eigen::VectorXd &, const Eigen::VectorXd &,
                                     const Eigen::VectorXd &) const = 0;
};
}  // namespace inverse_dynamics_solver
