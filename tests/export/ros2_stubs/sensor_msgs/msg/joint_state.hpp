#pragma once
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace sensor_msgs::msg
{
struct JointState
{
  using ConstSharedPtr = std::shared_ptr<const JointState>;
  struct
  {
    struct
    {
      std::int32_t sec = 0;
      std::uint32_t nanosec = 0;
    } stamp;
    std::string frame_id;
  } header;
  std::vector<std::string> name;
  std::vector<double> position, velocity, effort;
};
}  // namespace sensor_msgs::msg
