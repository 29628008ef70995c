// Drives an exported node over the stubs. Usage: replay RATE STATES TORQUES; rows of stamp and positions, raw doubles.
#include <cmath>
#include <fstream>
#include <iostream>
#include <thread>

#include "node.hpp"

using sensor_msgs::msg::JointState;
using std_msgs::msg::Float64MultiArray;

int main(int, char ** argv)
{
  auto & world = rclcpp::stub_world();
  world.parameters["update_rate"] = static_cast<std::int64_t>(std::stol(argv[1]));
  std::unique_ptr<arm_controller::LawNode> node;
  try {
    node = std::make_unique<arm_controller::LawNode>();
  } catch (const std::invalid_argument & error) {
    std::cout << error.what() << "\n";
    return 3;
  }
  std::ifstream file(argv[2], std::ios::binary);
  std::ofstream torques(argv[3], std::ios::binary);
  const auto callback =
    std::any_cast<std::function<void(std::shared_ptr<const JointState>)>>(world.callbacks.at("/joint_states"));
  const std::string topic = "/effort_controller/commands";
  double row[3];
  while (file.read(reinterpret_cast<char *>(row), sizeof row)) {
    JointState message;
    message.header.stamp.sec = static_cast<std::int32_t>(std::floor(row[0]));
    message.header.stamp.nanosec = static_cast<std::uint32_t>(std::lround(1e9 * (row[0] - std::floor(row[0]))));
    message.name = {"gripper", "elbow", "shoulder"};  // more joints, in another order
    message.position = {7.0, row[2], row[1]};
    callback(std::make_shared<const JointState>(message));
    message.name = {"gripper", "wrist", "shoulder"};
    callback(std::make_shared<const JointState>(message));  // of another robot
    message.position.pop_back();
    callback(std::make_shared<const JointState>(message));  // malformed
    const auto count = static_cast<double>(world.n_published[topic]);
    double values[3] = {count, 0.0, 0.0};
    if (count > 0.0) {
      const auto & data = std::any_cast<const Float64MultiArray &>(world.published.at(topic)).data;
      values[1] = data[0];
      values[2] = data[1];
    }
    torques.write(reinterpret_cast<const char *>(values), sizeof values);
  }
  const int published = world.n_published[topic];
  std::this_thread::sleep_for(std::chrono::milliseconds(10));
  world.timer();
  std::cout << node->ignored() << " ignored; " << world.n_published[topic] - published << " after silence; "
            << world.last_error << "\n";
  return 0;
}
