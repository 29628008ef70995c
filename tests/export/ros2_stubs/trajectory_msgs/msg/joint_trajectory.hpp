#pragma once
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace trajectory_msgs::msg
{
struct JointTrajectoryPoint
{
  std::vector<double> positions, velocities, accelerations, effort;
  struct
  {
    std::int32_t sec = 0;
    std::uint32_t nanosec = 0;
  } time_from_start;
};

struct JointTrajectory
{
  using ConstSharedPtr = std::shared_ptr<const JointTrajectory>;
  std::vector<std::string> joint_names;
  std::vector<JointTrajectoryPoint> points;
};
}  // namespace trajectory_msgs::msg
