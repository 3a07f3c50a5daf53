// FACE IT! in Ceres: for each frame of a clip the pose (Eqs. 8, 9), then the weights (Eqs. 10-12), started from the
// frame before. The yardstick of benchmarks/solve_time.py, which writes the clip and reads the one JSON line printed
// here.
//
//     g++ -std=c++17 -O3 -march=native -I/usr/include/eigen3 face_it.cpp -lceres -lglog -o face_it && ./face_it clip.txt
//
// Written to be as fast as the public interface of Ceres allows: every Jacobian is analytic, each energy is one
// residual block (68 small blocks cost several times more), and both problems are built once and only see new data.

#include <ceres/ceres.h>

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

namespace {

constexpr int kPoints = 68;
constexpr int kShapes = 43;

using Points3 = Eigen::Matrix<double, kPoints, 3, Eigen::RowMajor>;
using Points2 = Eigen::Matrix<double, kPoints, 2, Eigen::RowMajor>;
using PointVector = Eigen::Matrix<double, 3 * kPoints, 1>;
using ShapeBasis = Eigen::Matrix<double, 3 * kPoints, kShapes, Eigen::RowMajor>;
using ProjectionDerivative = Eigen::Matrix<double, 2, 3>;
using Clock = std::chrono::steady_clock;

struct Camera {
  double focal_x, focal_y, principal_x, principal_y;

  Eigen::Vector2d Project(const Eigen::Vector3d& point) const {
    return {focal_x * point.x() / point.z() + principal_x, focal_y * point.y() / point.z() + principal_y};
  }

  ProjectionDerivative Derivative(const Eigen::Vector3d& point) const {
    const double inverse_z = 1.0 / point.z();
    const double fx = focal_x * inverse_z, fy = focal_y * inverse_z;
    ProjectionDerivative derivative;
    derivative << fx, 0.0, -fx * point.x() * inverse_z,  //
        0.0, fy, -fy * point.y() * inverse_z;
    return derivative;
  }
};

struct Energies {
  double tau, beta, sigma;      // the factors omega
  double a, b, c;               // the shape of E_beta
  double rotation_millimetres;  // that one radian counts as in E_tau
};

struct Clip {
  int pose_iterations = 0, expression_iterations = 0;  // rho and epsilon
  double tolerance = 0.0;
  Camera camera{};
  Energies energies{};
  std::array<double, 6> start{};  // axis-angle and translation of the first frame
  PointVector neutral;
  ShapeBasis shapes;
  std::vector<Points2> observed;
};

// What changes from frame to frame; the cost functions look at it.
struct FrameState {
  std::array<double, 3> rotation{}, translation{};
  std::array<double, kShapes> weights{};
  std::array<double, 6> last_pose{}, before_last_pose{};
  bool has_history = false;
  Points2 observed;
  Points3 points_head;              // of the weights, for the pose
  Eigen::Matrix3d rotation_matrix;  // of the pose, for the weights
};

Eigen::Matrix3d CrossMatrix(const Eigen::Vector3d& v) {
  Eigen::Matrix3d matrix;
  matrix << 0.0, -v.z(), v.y(), v.z(), 0.0, -v.x(), -v.y(), v.x(), 0.0;
  return matrix;
}

Eigen::Matrix3d RotationMatrix(const Eigen::Vector3d& axis_angle) {
  const double angle = axis_angle.norm();
  if (angle < 1e-8) return Eigen::Matrix3d::Identity() + CrossMatrix(axis_angle);
  return Eigen::AngleAxisd(angle, axis_angle / angle).toRotationMatrix();
}

// J with R(r + dr) = exp(J dr) R(r) to first order.
Eigen::Matrix3d LeftJacobian(const Eigen::Vector3d& axis_angle) {
  const double angle = axis_angle.norm();
  const Eigen::Matrix3d cross = CrossMatrix(axis_angle);
  if (angle < 1e-4) return Eigen::Matrix3d::Identity() + 0.5 * cross;
  const double squared = angle * angle;
  return Eigen::Matrix3d::Identity() + (1.0 - std::cos(angle)) / squared * cross +
         (angle - std::sin(angle)) / (squared * angle) * cross * cross;
}

PointVector PointsHead(const Clip& clip, const double* weights) {
  return clip.neutral + clip.shapes * Eigen::Map<const Eigen::Matrix<double, kShapes, 1>>(weights);
}

// E_pose (Eq. 8) of all landmarks; parameter blocks: axis-angle, translation.
class PoseCost final : public ceres::SizedCostFunction<2 * kPoints, 3, 3> {
 public:
  PoseCost(const Clip& clip, const FrameState& state) : clip_(clip), state_(state) {}

  bool Evaluate(double const* const* blocks, double* residuals, double** jacobians) const override {
    const Eigen::Vector3d axis_angle(blocks[0]), translation(blocks[1]);
    const Eigen::Matrix3d rotation = RotationMatrix(axis_angle);
    const bool wants_jacobian = jacobians != nullptr;
    const Eigen::Matrix3d left = wants_jacobian ? LeftJacobian(axis_angle) : Eigen::Matrix3d::Zero();
    using Rows = Eigen::Matrix<double, 2, 3, Eigen::RowMajor>;
    for (int i = 0; i < kPoints; ++i) {
      const Eigen::Vector3d turned = rotation * state_.points_head.row(i).transpose();
      const Eigen::Vector3d point = turned + translation;
      Eigen::Map<Eigen::Vector2d>(residuals + 2 * i) =
          clip_.camera.Project(point) - state_.observed.row(i).transpose();
      if (!wants_jacobian) continue;
      const ProjectionDerivative derivative = clip_.camera.Derivative(point);
      if (jacobians[0]) Eigen::Map<Rows>(jacobians[0] + 6 * i) = -derivative * CrossMatrix(turned) * left;
      if (jacobians[1]) Eigen::Map<Rows>(jacobians[1] + 6 * i) = derivative;
    }
    return true;
  }

 private:
  const Clip& clip_;
  const FrameState& state_;
};

// E_tau (Eq. 9); parameter blocks: axis-angle, translation. Zero while there are no two poses before.
class TauCost final : public ceres::SizedCostFunction<6, 3, 3> {
 public:
  TauCost(const Clip& clip, const FrameState& state) : clip_(clip), state_(state) {}

  bool Evaluate(double const* const* blocks, double* residuals, double** jacobians) const override {
    const double factor = state_.has_history ? std::sqrt(clip_.energies.tau) : 0.0;
    const double scales[2] = {factor * clip_.energies.rotation_millimetres, factor};
    for (int k = 0; k < 6; ++k) {
      const double second_difference = state_.before_last_pose[k] - 2.0 * state_.last_pose[k] + blocks[k / 3][k % 3];
      residuals[k] = scales[k / 3] * second_difference;
    }
    for (int block = 0; jacobians != nullptr && block < 2; ++block) {
      if (!jacobians[block]) continue;
      std::fill_n(jacobians[block], 18, 0.0);
      for (int axis = 0; axis < 3; ++axis) jacobians[block][(3 * block + axis) * 3 + axis] = scales[block];
    }
    return true;
  }

 private:
  const Clip& clip_;
  const FrameState& state_;
};

// E_fit (Eq. 10) of all landmarks; parameter block: weights.
class FitCost final : public ceres::SizedCostFunction<2 * kPoints, kShapes> {
 public:
  FitCost(const Clip& clip, const FrameState& state) : clip_(clip), state_(state) {}

  bool Evaluate(double const* const* blocks, double* residuals, double** jacobians) const override {
    const Eigen::Vector3d translation(state_.translation.data());
    const PointVector points = PointsHead(clip_, blocks[0]);
    const bool wants_jacobian = jacobians != nullptr && jacobians[0] != nullptr;
    using Rows = Eigen::Matrix<double, 2, kShapes, Eigen::RowMajor>;
    for (int i = 0; i < kPoints; ++i) {
      const Eigen::Vector3d point = state_.rotation_matrix * points.segment<3>(3 * i) + translation;
      Eigen::Map<Eigen::Vector2d>(residuals + 2 * i) =
          clip_.camera.Project(point) - state_.observed.row(i).transpose();
      if (!wants_jacobian) continue;
      const ProjectionDerivative derivative = clip_.camera.Derivative(point) * state_.rotation_matrix;
      Eigen::Map<Rows>(jacobians[0] + 2 * kShapes * i).noalias() =
          derivative.lazyProduct(clip_.shapes.middleRows<3>(3 * i));
    }
    return true;
  }

 private:
  const Clip& clip_;
  const FrameState& state_;
};

// E_beta (Eq. 12) and E_sigma (Eq. 11), one residual each; parameter block: weights.
class PriorCost final : public ceres::SizedCostFunction<2, kShapes> {
 public:
  explicit PriorCost(const Energies& energies) : energies_(energies) {}

  bool Evaluate(double const* const* blocks, double* residuals, double** jacobians) const override {
    const auto& [tau, omega_beta, omega_sigma, a, b, c, rotation_millimetres] = energies_;
    const double beta_factor = std::sqrt(omega_beta), sigma_factor = std::sqrt(omega_sigma);
    const bool wants_jacobian = jacobians != nullptr && jacobians[0] != nullptr;
    double range = 0.0, norm = 0.0;
    for (int k = 0; k < kShapes; ++k) {
      const double weight = blocks[0][k];
      const double upper = (weight - a) / b, lower = (weight + a - 1.0) / b;
      range += M_PI / 4.0 * (std::atan(upper) - std::atan(lower)) + c;
      norm += std::abs(weight);
      if (!wants_jacobian) continue;
      const double slope = M_PI / (4.0 * b) * (1.0 / (1.0 + upper * upper) - 1.0 / (1.0 + lower * lower));
      jacobians[0][k] = beta_factor * slope;
      jacobians[0][kShapes + k] = sigma_factor * ((weight > 0.0) - (weight < 0.0));
    }
    residuals[0] = beta_factor * range;
    residuals[1] = sigma_factor * norm;
    return true;
  }

 private:
  const Energies energies_;
};

Clip ReadClip(const std::string& path) {
  std::ifstream file(path);
  const auto next = [&file, &path]() {
    double value;
    if (!(file >> value)) throw std::runtime_error(path + " ends early or holds something that is no number");
    return value;
  };
  if (next() != kPoints || next() != kShapes) throw std::runtime_error(path + " is not of 68 points and 43 shapes");
  Clip clip;
  clip.observed.resize(static_cast<std::size_t>(next()));
  clip.pose_iterations = static_cast<int>(next());
  clip.expression_iterations = static_cast<int>(next());
  clip.tolerance = next();
  Energies& energies = clip.energies;
  for (double* value : {&energies.tau, &energies.beta, &energies.sigma, &energies.a, &energies.b, &energies.c,
                        &energies.rotation_millimetres}) {
    *value = next();
  }
  Camera& camera = clip.camera;
  for (double* value : {&camera.focal_x, &camera.focal_y, &camera.principal_x, &camera.principal_y}) *value = next();
  std::generate(clip.start.begin(), clip.start.end(), next);
  std::generate(clip.neutral.data(), clip.neutral.data() + clip.neutral.size(), next);
  for (int shape = 0; shape < kShapes; ++shape) {
    for (int row = 0; row < 3 * kPoints; ++row) clip.shapes(row, shape) = next();
  }
  for (Points2& points : clip.observed) std::generate(points.data(), points.data() + points.size(), next);
  return clip;
}

ceres::Solver::Options SolverOptions(int iterations, double tolerance) {
  ceres::Solver::Options options;
  options.max_num_iterations = iterations;
  options.function_tolerance = tolerance;
  options.linear_solver_type = ceres::DENSE_NORMAL_CHOLESKY;
  options.logging_type = ceres::SILENT;
  options.num_threads = 1;
  return options;
}

double RootMeanSquareError(const Clip& clip, const FrameState& state) {
  const PointVector points = PointsHead(clip, state.weights.data());
  const Eigen::Vector3d translation(state.translation.data());
  double sum = 0.0;
  for (int i = 0; i < kPoints; ++i) {
    const Eigen::Vector3d point = state.rotation_matrix * points.segment<3>(3 * i) + translation;
    sum += (clip.camera.Project(point) - state.observed.row(i).transpose()).squaredNorm();
  }
  return std::sqrt(sum / kPoints);
}

double Milliseconds(Clock::duration duration) { return std::chrono::duration<double, std::milli>(duration).count(); }

double Median(std::vector<double> values) {
  const auto middle = values.begin() + values.size() / 2;
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

double Mean(const std::vector<double>& values) {
  return Eigen::Map<const Eigen::VectorXd>(values.data(), values.size()).mean();
}

void SolveClip(const Clip& clip) {
  FrameState state;
  std::copy_n(clip.start.begin(), 3, state.rotation.begin());
  std::copy_n(clip.start.begin() + 3, 3, state.translation.begin());

  ceres::Problem pose, expression;
  pose.AddResidualBlock(new PoseCost(clip, state), nullptr, state.rotation.data(), state.translation.data());
  pose.AddResidualBlock(new TauCost(clip, state), nullptr, state.rotation.data(), state.translation.data());
  expression.AddResidualBlock(new FitCost(clip, state), nullptr, state.weights.data());
  expression.AddResidualBlock(new PriorCost(clip.energies), nullptr, state.weights.data());
  const ceres::Solver::Options pose_options = SolverOptions(clip.pose_iterations, clip.tolerance);
  const ceres::Solver::Options expression_options = SolverOptions(clip.expression_iterations, clip.tolerance);

  std::vector<double> pose_ms, expression_ms, frame_ms, pose_steps, expression_steps, errors_px;
  for (std::size_t frame = 0; frame < clip.observed.size(); ++frame) {
    const Clock::time_point began = Clock::now();
    state.observed = clip.observed[frame];
    state.has_history = frame >= 2;
    const PointVector points = PointsHead(clip, state.weights.data());
    state.points_head = Eigen::Map<const Points3>(points.data());
    ceres::Solver::Summary summary;
    ceres::Solve(pose_options, &pose, &summary);
    pose_steps.push_back(static_cast<double>(summary.iterations.size()) - 1.0);
    const Clock::time_point middle = Clock::now();
    state.rotation_matrix = RotationMatrix(Eigen::Vector3d(state.rotation.data()));
    ceres::Solve(expression_options, &expression, &summary);
    const Clock::time_point ended = Clock::now();
    expression_steps.push_back(static_cast<double>(summary.iterations.size()) - 1.0);

    pose_ms.push_back(Milliseconds(middle - began));
    expression_ms.push_back(Milliseconds(ended - middle));
    frame_ms.push_back(Milliseconds(ended - began));
    errors_px.push_back(RootMeanSquareError(clip, state));
    state.before_last_pose = state.last_pose;
    std::copy_n(state.rotation.begin(), 3, state.last_pose.begin());
    std::copy_n(state.translation.begin(), 3, state.last_pose.begin() + 3);
  }
  std::printf(
      "{\"frame_ms\": %.6f, \"pose_ms\": %.6f, \"expression_ms\": %.6f, \"pose_iterations\": %.4f, "
      "\"expression_iterations\": %.4f, \"rmse_px\": %.9f}\n",
      Median(frame_ms), Median(pose_ms), Median(expression_ms), Mean(pose_steps), Mean(expression_steps),
      Mean(errors_px));
}

}  // namespace

int main(int argument_count, char** arguments) {
  if (argument_count != 2) {
    std::fprintf(stderr, "usage: %s clip.txt\n", arguments[0]);
    return 2;
  }
  try {
    SolveClip(ReadClip(arguments[1]));
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
  return 0;
}
