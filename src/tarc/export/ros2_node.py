"""C++ of a plain node that runs a law, for robots without ros2_control."""

from string import Template

HEADER = Template("""// The law as a plain node: one step for each joint state, effort commands out.
#ifndef ${PACKAGE}__NODE_HPP_
#define ${PACKAGE}__NODE_HPP_

#include <array>
#include <chrono>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "law.hpp"
#include "rclcpp/rclcpp.hpp"
#include "sensor_msgs/msg/joint_state.hpp"
#include "std_msgs/msg/float64_multi_array.hpp"
#include "trajectory.hpp"
#include "trajectory_msgs/msg/joint_trajectory.hpp"

namespace $package
{
/// The stamps of the joint states are the clock. Where they skip periods, the law bridges these.
class LawNode : public rclcpp::Node
{
public:
  explicit LawNode(const rclcpp::NodeOptions & options = rclcpp::NodeOptions())
  : rclcpp::Node("${name}_law", options)
  {
    const auto rate = declare_parameter<int64_t>("update_rate", UPDATE_RATE);
    if (rate != UPDATE_RATE) {
      throw std::invalid_argument(
        "update_rate: got " + std::to_string(rate) + " Hz; the law is for " + std::to_string(UPDATE_RATE) +
        " Hz and no other");
    }
    const auto prefix = declare_parameter<std::string>("prefix", "");
    joints_ = law_joints();
    for (auto & name : joints_) {
      name = prefix + name;
    }
    const auto commands = declare_parameter<std::string>("command_topic", "/effort_controller/commands");
    command_ = create_publisher<std_msgs::msg::Float64MultiArray>(commands, rclcpp::QoS(10));
    trajectory_ = create_subscription<trajectory_msgs::msg::JointTrajectory>(
      "~/joint_trajectory", rclcpp::QoS(10),
      [this](const trajectory_msgs::msg::JointTrajectory::ConstSharedPtr message) {take_trajectory(*message);});
    state_ = create_subscription<sensor_msgs::msg::JointState>(
      "/joint_states", rclcpp::QoS(10),
      [this](const sensor_msgs::msg::JointState::ConstSharedPtr message) {take_state(*message);});
    timer_ = create_wall_timer(std::chrono::nanoseconds(std::lround(1e9 * PERIOD)), [this]() {watch_silence();});
  }

  /// Messages that had not the law's joints or no fitting stamp.
  long ignored() const {return ignored_;}

private:
  static constexpr int OBSERVED = 20;  // joint states whose rate is compared with the law's before it starts
  static constexpr int SILENT = 3;  // periods without a joint state after which each counts as missing

  void take_trajectory(const trajectory_msgs::msg::JointTrajectory & message)
  {
    auto read = Trajectory::read(message, joints_);
    if (read.first) {
      follower_.take(std::move(read.first));
    } else {
      RCLCPP_ERROR(get_logger(), "joint_trajectory: %s", read.second.c_str());
    }
  }

  void take_state(const sensor_msgs::msg::JointState & message)
  {
    const auto wrong = message.position.size() == message.name.size() ? missing_names(message.name) : "no positions";
    if (!wrong.empty()) {
      if (++ignored_ == 1) {
        RCLCPP_ERROR(get_logger(), "joint_states: %s; such messages are ignored", wrong.c_str());
      }
      return;
    }
    const auto order = places(joints_, message.name);
    Vector position;
    for (std::size_t i = 0; i < JOINTS; ++i) {
      position[i] = message.position[order[i]];
    }
    const double stamp = static_cast<double>(message.header.stamp.sec) + 1e-9 * message.header.stamp.nanosec;
    last_ = std::chrono::steady_clock::now();
    if (!is_running_) {
      observe(position, stamp);
      return;
    }
    const double periods = std::floor((stamp - stamp_) / PERIOD + 0.25);
    if (!(periods >= 1.0)) {
      ++ignored_;  // older, repeated, or of a faster publisher
      return;
    }
    for (double k = 1.0; k < periods && k < MOST_SKIPPED; ++k) {
      stamp_ += PERIOD;
      step(unknown(), MISSING);
    }
    const double elapsed = stamp - stamp_;
    stamp_ = stamp;
    step(position, elapsed);
  }

  /// Start once the joint states have had the law's rate for a while.
  void observe(const Vector & position, double stamp)
  {
    if (observed_ == 0 || !are_finite(position)) {
      observed_ = 1;
      first_ = stamp;
      return;
    }
    if (++observed_ <= OBSERVED) {
      return;
    }
    const double rate = (observed_ - 1) / (stamp - first_);
    observed_ = 0;
    if (!(std::fabs(rate * PERIOD - 1.0) < 0.05)) {
      RCLCPP_ERROR(
        get_logger(), "joint_states: they come at %.1f Hz; the law is for %ld Hz, and does not start", rate,
        UPDATE_RATE);
      return;
    }
    is_running_ = law_.reset(position, {});
    follower_.hold(position);
    stamp_ = stamp;
  }

  void watch_silence()
  {
    const std::chrono::duration<double> silence = std::chrono::steady_clock::now() - last_;
    if (is_running_ && silence.count() > SILENT * PERIOD) {
      stamp_ += PERIOD;
      step(unknown(), MISSING);
    }
  }

  void step(const Vector & position, double elapsed)
  {
    Vector torque;
    const auto status = law_.step(position, follower_.next(), unknown(), elapsed, torque);
    if (status == ${NAME}_FAULT && !is_in_fault_) {
      RCLCPP_ERROR(get_logger(), "%d samples missing in a row: the safe torque is applied from now on", law_.missing());
    }
    is_in_fault_ = status == ${NAME}_FAULT;
    if (law_.flags() & ~flags_) {
      RCLCPP_ERROR(get_logger(), "left what was certified: flags %u of ${name}.h", law_.flags());
    }
    flags_ = law_.flags();
    std_msgs::msg::Float64MultiArray message;
    message.data.assign(torque.begin(), torque.end());
    command_->publish(message);
  }

  std::string missing_names(const std::vector<std::string> & names) const
  {
    std::vector<std::string> missing;
    for (const auto & name : joints_) {
      if (std::count(names.begin(), names.end(), name) != 1) {
        missing.push_back(name);
      }
    }
    return missing.empty() ? "" : "they lack " + joined(missing);
  }

  static Vector unknown()
  {
    Vector result;
    result.fill(MISSING);
    return result;
  }

  static constexpr double MOST_SKIPPED = 1000.0;  // far more than a law bridges

  Law law_;
  Follower follower_;
  std::vector<std::string> joints_;
  bool is_running_ = false, is_in_fault_ = false;
  int observed_ = 0;
  long ignored_ = 0;
  unsigned flags_ = 0;
  double first_ = 0.0, stamp_ = 0.0;
  std::chrono::steady_clock::time_point last_{};
  rclcpp::Publisher<std_msgs::msg::Float64MultiArray>::SharedPtr command_;
  rclcpp::Subscription<trajectory_msgs::msg::JointTrajectory>::SharedPtr trajectory_;
  rclcpp::Subscription<sensor_msgs::msg::JointState>::SharedPtr state_;
  rclcpp::TimerBase::SharedPtr timer_;
};
}  // namespace $package

#endif
""")

MAIN = Template("""// Runs the law as a plain node.
#include <cstdio>
#include <exception>
#include <memory>

#include "node.hpp"

int main(int argc, char ** argv)
{
  rclcpp::init(argc, argv);
  int result = 0;
  try {
    rclcpp::spin(std::make_shared<$package::LawNode>());
  } catch (const std::exception & error) {
    std::fprintf(stderr, "%s\\n", error.what());
    result = 1;
  }
  rclcpp::shutdown();
  return result;
}
""")
