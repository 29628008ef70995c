// Loads an exported controller as pluginlib does, and drives it as a controller manager does, over the stubs.
// Usage: replay LIBRARY CLASS RATE PREFIX INPUTS TORQUES [TRAJECTORY REFERENCES]; numbers are raw doubles in files.
#include <dlfcn.h>

#include <cmath>
#include <cstdio>
#include <fstream>
#include <iostream>

#include "controller_interface/chainable_controller_interface.hpp"
#include "trajectory_msgs/msg/joint_trajectory.hpp"

using controller_interface::ChainableControllerInterface;
using Trajectory = trajectory_msgs::msg::JointTrajectory;

static std::vector<double> read(const char * path)
{
  std::ifstream file(path, std::ios::binary | std::ios::ate);
  std::vector<double> values(static_cast<std::size_t>(file.tellg()) / sizeof(double));
  file.seekg(0);
  file.read(reinterpret_cast<char *>(values.data()), static_cast<std::streamsize>(values.size() * sizeof(double)));
  return values;
}

static void write(const char * path, const std::vector<double> & values)
{
  std::ofstream file(path, std::ios::binary);
  file.write(
    reinterpret_cast<const char *>(values.data()), static_cast<std::streamsize>(values.size() * sizeof(double)));
}

template <typename Interface>
static double value_of(const Interface & interface)
{
#if STUB_VERSION >= 4027
  return interface.get_optional().value();
#else
  return interface.get_value();
#endif
}

int main(int, char ** argv)
{
  void * const library = dlopen(argv[1], RTLD_NOW);
  if (!library) {
    std::cout << dlerror() << "\n";
    return 2;
  }
  void * (*create)(const char *);
  *reinterpret_cast<void **>(&create) = dlsym(library, "stub_create_plugin");
  std::unique_ptr<ChainableControllerInterface> law(static_cast<ChainableControllerInterface *>(create(argv[2])));
  if (!law) {
    std::cout << "no class " << argv[2] << "\n";
    return 2;
  }
  auto & world = rclcpp::stub_world();
  const std::string prefix = argv[4];
  world.parameters["prefix"] = prefix;
  world.parameters["joints"] = std::vector<std::string>{prefix + "elbow", prefix + "shoulder"};  // another order
  law->stub_init("arm_controller", static_cast<unsigned int>(std::stoul(argv[3])));
  const rclcpp_lifecycle::State state;
  const auto configured = law->on_configure(state);
  if (configured != controller_interface::CallbackReturn::SUCCESS) {
    std::cout << "not configured: " << world.last_error << "\n";
    return 3;
  }

  // interfaces in another order than the law's
  const std::size_t n = 2;
  const auto inputs = read(argv[5]);
  std::vector<double> position(n), effort(n), torques;
  std::vector<hardware_interface::StateInterface> states;
  std::vector<hardware_interface::CommandInterface> commands;
  const auto claimed = law->state_interface_configuration();
  if (claimed.names != std::vector<std::string>{prefix + "shoulder/position", prefix + "elbow/position"}) {
    std::cout << "other interfaces are claimed\n";
    return 3;
  }
  const std::string names[] = {prefix + "shoulder", prefix + "elbow"};
  for (std::size_t i = 0; i < n; ++i) {
    states.emplace_back(names[n - 1 - i], "position", &position[n - 1 - i]);
    commands.emplace_back(names[n - 1 - i], "effort", &effort[n - 1 - i]);
  }
  std::vector<hardware_interface::LoanedStateInterface> loaned_states;
  std::vector<hardware_interface::LoanedCommandInterface> loaned_commands;
  for (std::size_t i = 0; i < n; ++i) {
    loaned_states.emplace_back(states[i]);
    loaned_commands.emplace_back(commands[i]);
  }
  const auto references = law->stub_references();
  law->assign_interfaces(std::move(loaned_commands), std::move(loaned_states));
  position = {std::nan(""), 0.0};
  if (law->on_activate(state) == controller_interface::CallbackReturn::SUCCESS) {
    std::cout << "activated without a position\n";
    return 3;
  }
  for (std::size_t i = 0; i < n; ++i) {
    position[i] = inputs[i];
    effort[i] = inputs[n + i];
  }
  if (law->on_activate(state) != controller_interface::CallbackReturn::SUCCESS) {
    std::cout << "not activated: " << world.last_error << "\n";
    return 3;
  }

  law->stub_is_chained = true;
  const std::size_t n_steps = (inputs.size() - 2 * n) / (5 * n);
  for (std::size_t k = 0; k < n_steps; ++k) {
    const double * const row = &inputs[2 * n + 5 * n * k];
    for (std::size_t i = 0; i < n; ++i) {
      position[i] = row[i];
      for (std::size_t quantity = 0; quantity < 3; ++quantity) {
        (void)references[3 * i + quantity]->set_value(row[n * (1 + quantity) + i]);
      }
      if (std::isfinite(row[4 * n + i])) {
        effort[i] = row[4 * n + i];  // as a limit of the command interface leaves it
      }
    }
    const rclcpp::Duration absurd(static_cast<std::int64_t>(k) * 977 - 1000000000);  // the law must not look at it
    if (law->update(rclcpp::Time(1000000 * static_cast<std::int64_t>(k)), absurd) != controller_interface::return_type::OK) {
      std::cout << "the update failed\n";
      return 3;
    }
    torques.insert(torques.end(), effort.begin(), effort.end());
  }
  write(argv[6], torques);
  std::cout << "last message: " << world.last_error << "\n";

  if (argv[7]) {  // without a controller ahead: rows of time, position, velocity and acceleration
    law->stub_is_chained = false;
    const auto rows = read(argv[7]);
    Trajectory message;
    message.joint_names = {names[1], names[0]};
    for (std::size_t k = 0; k < rows.size(); k += 1 + 3 * n) {
      const double * const row = &rows[k];
      trajectory_msgs::msg::JointTrajectoryPoint point;
      point.time_from_start.sec = static_cast<std::int32_t>(row[0]);
      point.time_from_start.nanosec = static_cast<std::uint32_t>(std::lround(1e9 * (row[0] - std::floor(row[0]))));
      point.positions = {row[2], row[1]};
      if (std::isfinite(row[3])) {
        point.velocities = {row[4], row[3]};
      }
      if (std::isfinite(row[5])) {
        point.accelerations = {row[6], row[5]};
      }
      message.points.push_back(point);
    }
    const auto callback = std::any_cast<std::function<void(std::shared_ptr<const Trajectory>)>>(
      world.callbacks.at("~/joint_trajectory"));
    position = {0.25, -0.5};
    (void)law->on_deactivate(state);
    if (effort[0] != 0.0 || effort[1] != 0.0 || law->on_activate(state) != controller_interface::CallbackReturn::SUCCESS)
    {
      std::cout << "no zero torque at the end, or no second start\n";
      return 3;
    }
    auto strange = message;
    strange.joint_names = {"wrist", names[0]};
    callback(std::make_shared<const Trajectory>(strange));
    std::cout << "refused: " << world.last_error << "\n";
    callback(std::make_shared<const Trajectory>(message));
    std::vector<double> followed;
    for (int k = 0; k < 1000; ++k) {
      (void)law->update(rclcpp::Time(), rclcpp::Duration(0));
      for (const auto & reference : references) {
        followed.push_back(value_of(*reference));
      }
    }
    write(argv[8], followed);
  }

#if STUB_VERSION >= 4027
  // another thread has the command: the old torque stays, and the law goes on from it
  const double before = effort[1];
  commands[0].is_busy = true;
  (void)law->update(rclcpp::Time(), rclcpp::Duration(0));
  commands[0].is_busy = false;
  if (effort[1] != before || !std::isfinite(effort[0])) {
    std::cout << "a busy interface was written\n";
    return 3;
  }
#endif
  std::cout << n_steps << " steps\n";
  return 0;
}
