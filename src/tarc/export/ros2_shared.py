"""C++ that the plugin and the node of a ROS 2 package share: names of the joints, and trajectories."""

from string import Template

LAW = Template("""// The law for plugin and node: its rate, its joints, and its step from numbers of ROS.
#ifndef ${PACKAGE}__LAW_HPP_
#define ${PACKAGE}__LAW_HPP_

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <string>
#include <vector>

#include "${name}.h"

namespace $package
{
constexpr std::size_t JOINTS = ${NAME}_JOINTS;
constexpr long UPDATE_RATE = $rate;  // Hz
constexpr double PERIOD = 1.0 / UPDATE_RATE;  // s
constexpr double MISSING = std::numeric_limits<double>::quiet_NaN();

using Vector = std::array<double, JOINTS>;

struct Reference
{
  Vector position, velocity, acceleration;
};

/// Names of the law's joints, in its order.
inline std::vector<std::string> law_joints()
{
  return {$joints};
}

inline std::string joined(const std::vector<std::string> & names)
{
  std::string text;
  for (const auto & name : names) {
    text += text.empty() ? name : ", " + name;
  }
  return text.empty() ? "none" : text;
}

/// What is wrong with the joints of a robot, by their names; empty where they are the law's, in any order.
inline std::string wrong_joints(const std::vector<std::string> & needed, const std::vector<std::string> & given)
{
  std::vector<std::string> missing, unknown;
  for (const auto & name : needed) {
    if (std::count(given.begin(), given.end(), name) == 0) {
      missing.push_back(name);
    }
  }
  for (const auto & name : given) {
    if (std::count(needed.begin(), needed.end(), name) == 0 || std::count(given.begin(), given.end(), name) > 1) {
      unknown.push_back(name);
    }
  }
  if (missing.empty() && unknown.empty()) {
    return "";
  }
  return "got the joints " + joined(given) + "; the law is for " + joined(needed) + ". Missing: " + joined(missing) +
         "; unknown or twice: " + joined(unknown);
}

/// Place of each needed name among the given ones; the names must fit.
inline std::array<std::size_t, JOINTS> places(
  const std::vector<std::string> & needed, const std::vector<std::string> & given)
{
  std::array<std::size_t, JOINTS> result{};
  for (std::size_t i = 0; i < JOINTS; ++i) {
    result[i] = static_cast<std::size_t>(std::find(given.begin(), given.end(), needed[i]) - given.begin());
  }
  return result;
}

inline bool are_finite(const Vector & values)
{
  return std::all_of(values.begin(), values.end(), [](double value) {return std::isfinite(value);});
}

/// The law with its memory.
class Law
{
public:
  /// Start at rest at a position with a torque already applied; false for numbers that are not finite.
  bool reset(const Vector & position, const Vector & torque)
  {
    ${name}_real q[JOINTS], applied[JOINTS];
    for (std::size_t i = 0; i < JOINTS; ++i) {
      q[i] = static_cast<${name}_real>(position[i]);
      applied[i] = static_cast<${name}_real>(torque[i]);
    }
    return ${name}_reset(&memory_, q, applied) == ${NAME}_OK;
  }

  /// One control period, and the time since the last sample. A number that is not finite is missing.
  ${name}_status step(
    const Vector & position, const Reference & reference, const Vector & applied, double elapsed, Vector & torque)
  {
    ${name}_input in;
    $elapsed
    for (std::size_t i = 0; i < JOINTS; ++i) {
      in.position[i] = static_cast<${name}_real>(position[i]);
      in.reference[i] = static_cast<${name}_real>(reference.position[i]);
      in.velocity_reference[i] = static_cast<${name}_real>(reference.velocity[i]);
      in.acceleration_reference[i] = static_cast<${name}_real>(reference.acceleration[i]);
      in.applied_torque[i] = static_cast<${name}_real>(applied[i]);
    }
    const ${name}_status status = ${name}_step(&memory_, &in, &output_);
    for (std::size_t i = 0; i < JOINTS; ++i) {
      torque[i] = static_cast<double>(output_.torque[i]);
    }
    return status;
  }

  int missing() const {return output_.missing;}

  /// What left the certified range since the start, as in ${name}.h; 0 where that is not watched.
  unsigned flags() const {return $flags;}

private:
  ${name}_t memory_{};
  ${name}_output output_{};
};
}  // namespace $package

#endif
""")

TRAJECTORY = Template("""// Trajectories of trajectory_msgs, interpolated as joint_trajectory_controller does.
#ifndef ${PACKAGE}__TRAJECTORY_HPP_
#define ${PACKAGE}__TRAJECTORY_HPP_

#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "law.hpp"
#include "trajectory_msgs/msg/joint_trajectory.hpp"

namespace $package
{
/// Point of a trajectory: its degree is what it has, 1 for positions, 3 with velocities, 5 with accelerations.
struct Point
{
  double time;
  Reference state;
  int degree;
};

/// Cubic or quintic from one point to the next, linear where velocities are missing.
inline Reference between(const Point & from, const Point & to, double time)
{
  Reference result;
  const int degree = std::min(from.degree, to.degree);
  const double h = to.time - from.time;
  const double u = time - from.time;
  for (std::size_t i = 0; i < JOINTS; ++i) {
    const double q0 = from.state.position[i], v0 = from.state.velocity[i], v1 = to.state.velocity[i];
    const double a0 = from.state.acceleration[i] * h, a1 = to.state.acceleration[i] * h;
    const double slope = (to.state.position[i] - q0) / h;
    double c[6] = {q0, slope, 0.0, 0.0, 0.0, 0.0};
    if (degree >= 3) {
      c[1] = v0;
      c[2] = (3.0 * slope - 2.0 * v0 - v1) / h;
      c[3] = (v0 + v1 - 2.0 * slope) / (h * h);
    }
    if (degree >= 5) {
      c[2] = from.state.acceleration[i] / 2.0;
      c[3] = (20.0 * slope - 12.0 * v0 - 8.0 * v1 - 3.0 * a0 + a1) / (2.0 * h * h);
      c[4] = (-30.0 * slope + 16.0 * v0 + 14.0 * v1 + 3.0 * a0 - 2.0 * a1) / (2.0 * h * h * h);
      c[5] = (12.0 * slope - 6.0 * (v0 + v1) + a1 - a0) / (2.0 * h * h * h * h);
    }
    result.position[i] = c[0] + u * (c[1] + u * (c[2] + u * (c[3] + u * (c[4] + u * c[5]))));
    result.velocity[i] = c[1] + u * (2.0 * c[2] + u * (3.0 * c[3] + u * (4.0 * c[4] + u * 5.0 * c[5])));
    result.acceleration[i] = 2.0 * c[2] + u * (6.0 * c[3] + u * (12.0 * c[4] + u * 20.0 * c[5]));
  }
  return result;
}

/// Points with times that increase, and what is wrong with a message that has none.
struct Trajectory
{
  std::vector<Point> points;
  std::size_t piece = 0;
  bool begins_now = true;  // with the reference that is followed then

  static std::pair<std::shared_ptr<Trajectory>, std::string> read(
    const trajectory_msgs::msg::JointTrajectory & message, const std::vector<std::string> & joints)
  {
    const auto wrong = wrong_joints(joints, message.joint_names);
    if (!wrong.empty()) {
      return {nullptr, wrong};
    }
    const auto order = places(joints, message.joint_names);
    auto result = std::make_shared<Trajectory>();
    result->points.push_back({0.0, {}, 5});  // where the reference is when it starts
    for (const auto & given : message.points) {
      Point point{};
      point.time = static_cast<double>(given.time_from_start.sec) + 1e-9 * given.time_from_start.nanosec;
      const auto fits = [](const std::vector<double> & values) {return values.empty() || values.size() == JOINTS;};
      if (given.positions.size() != JOINTS || !fits(given.velocities) || !fits(given.accelerations)) {
        return {nullptr, "a point has other numbers than one position per joint, and velocities of all or none"};
      }
      point.degree = given.velocities.empty() ? 1 : given.accelerations.empty() ? 3 : 5;
      for (std::size_t i = 0; i < JOINTS; ++i) {
        point.state.position[i] = given.positions[order[i]];
        point.state.velocity[i] = point.degree >= 3 ? given.velocities[order[i]] : 0.0;
        point.state.acceleration[i] = point.degree >= 5 ? given.accelerations[order[i]] : 0.0;
      }
      if (
        !are_finite(point.state.position) || !are_finite(point.state.velocity) ||
        !are_finite(point.state.acceleration))
      {
        return {nullptr, "a point has a number that is not finite"};
      }
      const bool is_first = result->points.size() == 1;
      if (point.time < 0.0 || (!is_first && point.time <= result->points.back().time)) {
        return {nullptr, "the times of the points do not increase"};
      }
      if (is_first && point.time <= 0.0) {
        result->points.clear();
        result->begins_now = false;
      }
      result->points.push_back(point);
    }
    if (message.points.empty()) {
      return {nullptr, "it has no point"};
    }
    return {result, ""};
  }

  /// Let it begin at the reference that is followed now.
  void begin(const Reference & now)
  {
    piece = 0;
    if (begins_now) {
      points.front().state = now;
    }
  }

  Reference at(double time)
  {
    while (piece + 1 < points.size() && time >= points[piece + 1].time) {
      ++piece;
    }
    if (piece + 1 < points.size()) {
      return between(points[piece], points[piece + 1], time);
    }
    return {points.back().state.position, {}, {}};
  }
};

/// The trajectory that is followed, and the one that another thread hands over. Nothing is freed by `next`.
class Follower
{
public:
  void hold(const Vector & position)
  {
    now_ = {position, {}, {}};
    is_active_ = false;
  }

  void take(std::shared_ptr<Trajectory> trajectory)
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    waiting_ = std::move(trajectory);
    is_waiting_ = true;
  }

  /// Reference of the next period.
  const Reference & next()
  {
    if (mutex_.try_lock()) {
      if (is_waiting_) {
        std::swap(active_, waiting_);
        is_waiting_ = false;
        is_active_ = true;
        step_ = 0;
        active_->begin(now_);
      }
      mutex_.unlock();
    }
    if (is_active_) {
      now_ = active_->at(static_cast<double>(step_) / UPDATE_RATE);
      ++step_;
    }
    return now_;
  }

private:
  std::mutex mutex_;
  std::shared_ptr<Trajectory> active_, waiting_;
  bool is_waiting_ = false, is_active_ = false;
  long step_ = 0;
  Reference now_{};
};
}  // namespace $package

#endif
""")
