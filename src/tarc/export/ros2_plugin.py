"""C++ of a controller for ros2_control, with the differences between its versions."""

from string import Template

HEADER = Template("""// The law as a controller of ros2_control: Humble (2.46), Jazzy (4.18), Kilted, rolling and later.
#ifndef ${PACKAGE}__CONTROLLER_HPP_
#define ${PACKAGE}__CONTROLLER_HPP_

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "controller_interface/chainable_controller_interface.hpp"
#include "controller_interface/version.h"
#include "hardware_interface/handle.hpp"
#include "law.hpp"
#include "rclcpp/rclcpp.hpp"
#include "rclcpp_lifecycle/state.hpp"
#include "trajectory.hpp"
#include "trajectory_msgs/msg/joint_trajectory.hpp"

// What changed in ros2_control, by the version that it changed in.
#define TARC_ROS2_CONTROL (1000 * CONTROLLER_INTERFACE_VERSION_MAJOR + CONTROLLER_INTERFACE_VERSION_MINOR)
#define TARC_UPDATE_REFERENCE_HAS_TIME (TARC_ROS2_CONTROL >= 3012)
#define TARC_SET_VALUE_TELLS (TARC_ROS2_CONTROL >= 4020)
#define TARC_HAS_OPTIONAL (TARC_ROS2_CONTROL >= 4027)
#define TARC_EXPORTS_LIST \\
  ((TARC_ROS2_CONTROL >= 4044 && TARC_ROS2_CONTROL < 5000) || \\
  (TARC_ROS2_CONTROL >= 5013 && TARC_ROS2_CONTROL < 6000) || TARC_ROS2_CONTROL >= 6005)

namespace $package
{
class Controller : public controller_interface::ChainableControllerInterface
{
public:
  using CallbackReturn = rclcpp_lifecycle::node_interfaces::LifecycleNodeInterface::CallbackReturn;

  controller_interface::InterfaceConfiguration command_interface_configuration() const override;
  controller_interface::InterfaceConfiguration state_interface_configuration() const override;
  CallbackReturn on_init() override;
  CallbackReturn on_configure(const rclcpp_lifecycle::State & previous_state) override;
  CallbackReturn on_activate(const rclcpp_lifecycle::State & previous_state) override;
  CallbackReturn on_deactivate(const rclcpp_lifecycle::State & previous_state) override;

  /// The period is not used: a step of the law takes its own. The time only tells whether sampling is even.
  controller_interface::return_type update_and_write_commands(
    const rclcpp::Time & time, const rclcpp::Duration & period) override;

protected:
#if TARC_EXPORTS_LIST
  std::vector<hardware_interface::CommandInterface::SharedPtr> on_export_reference_interfaces_list() override;
#else
  std::vector<hardware_interface::CommandInterface> on_export_reference_interfaces() override;
#endif
#if TARC_UPDATE_REFERENCE_HAS_TIME
  controller_interface::return_type update_reference_from_subscribers(
    const rclcpp::Time & time, const rclcpp::Duration & period) override;
#else
  controller_interface::return_type update_reference_from_subscribers() override;
#endif

private:
  controller_interface::InterfaceConfiguration interfaces(const std::string & quantity) const;
  bool order_interfaces();
  Vector positions() const;
  Vector commands() const;
  bool write(const Vector & torque);
  Reference reference() const;
  bool set_reference(const Reference & reference);

  Law law_;
  Follower follower_;
  std::vector<std::string> joints_;  // the robot's names, in the law's order
  std::array<std::size_t, JOINTS> position_place_{}, effort_place_{};
  bool is_in_fault_ = false, is_timed_ = false;
  std::int64_t last_time_ = 0;
  unsigned flags_ = 0;
  rclcpp::Subscription<trajectory_msgs::msg::JointTrajectory>::SharedPtr subscription_;
#if TARC_EXPORTS_LIST
  std::vector<hardware_interface::CommandInterface::SharedPtr> references_;
#endif
};
}  // namespace $package

#endif
""")

SOURCE = Template("""// The law as a chainable controller of ros2_control.
#include "controller.hpp"

#include <utility>

#include "pluginlib/class_list_macros.hpp"

namespace $package
{
namespace
{
const char * const QUANTITIES[] = {"position", "velocity", "acceleration"};

/// Value of an interface; NaN where another thread has it, which counts as missing.
template<typename Handle>
double value_of(const Handle & handle)
{
#if TARC_HAS_OPTIONAL
  return handle.template get_optional<double>().value_or(MISSING);
#else
  return handle.get_value();
#endif
}

/// Set an interface; false where another thread has it, so that its old value stays.
template<typename Handle>
bool set_value(Handle & handle, double value)
{
#if TARC_SET_VALUE_TELLS
  return handle.set_value(value);
#else
  handle.set_value(value);
  return true;
#endif
}

template<typename Handles>
bool find_places(
  const Handles & handles, const std::vector<std::string> & joints, const std::string & quantity,
  std::array<std::size_t, JOINTS> & places)
{
  for (std::size_t i = 0; i < JOINTS; ++i) {
    const auto is_wanted = [&](const auto & handle) {return handle.get_name() == joints[i] + "/" + quantity;};
    const auto found = std::find_if(handles.begin(), handles.end(), is_wanted);
    if (found == handles.end()) {
      return false;
    }
    places[i] = static_cast<std::size_t>(found - handles.begin());
  }
  return true;
}
}  // namespace

Controller::CallbackReturn Controller::on_init()
{
  auto_declare<std::vector<std::string>>("joints", law_joints());
  auto_declare<std::string>("prefix", "");
  return CallbackReturn::SUCCESS;
}

Controller::CallbackReturn Controller::on_configure(const rclcpp_lifecycle::State & /*previous_state*/)
{
  const long rate = static_cast<long>(get_update_rate());
  if (rate != UPDATE_RATE) {
    RCLCPP_ERROR(
      get_node()->get_logger(), "update_rate: got %ld Hz; the law is for %ld Hz and no other. Set update_rate of "
      "this controller, and one of the controller manager that is a multiple of it", rate, UPDATE_RATE);
    return CallbackReturn::FAILURE;
  }
  const auto prefix = get_node()->get_parameter("prefix").as_string();
  joints_ = law_joints();
  for (auto & name : joints_) {
    name = prefix + name;
  }
  const auto wrong = wrong_joints(joints_, get_node()->get_parameter("joints").as_string_array());
  if (!wrong.empty()) {
    RCLCPP_ERROR(get_node()->get_logger(), "joints: %s", wrong.c_str());
    return CallbackReturn::FAILURE;
  }
  subscription_ = get_node()->create_subscription<trajectory_msgs::msg::JointTrajectory>(
    "~/joint_trajectory", rclcpp::QoS(10), [this](const trajectory_msgs::msg::JointTrajectory::ConstSharedPtr message) {
      auto read = Trajectory::read(*message, joints_);
      if (read.first) {
        follower_.take(std::move(read.first));
      } else {
        RCLCPP_ERROR(get_node()->get_logger(), "joint_trajectory: %s", read.second.c_str());
      }
    });
  return CallbackReturn::SUCCESS;
}

controller_interface::InterfaceConfiguration Controller::interfaces(const std::string & quantity) const
{
  controller_interface::InterfaceConfiguration result{
    controller_interface::interface_configuration_type::INDIVIDUAL, {}};
  for (const auto & name : joints_) {
    result.names.push_back(name + "/" + quantity);
  }
  return result;
}

controller_interface::InterfaceConfiguration Controller::command_interface_configuration() const
{
  return interfaces("effort");
}

controller_interface::InterfaceConfiguration Controller::state_interface_configuration() const
{
  return interfaces("position");
}

bool Controller::order_interfaces()
{
  return find_places(state_interfaces_, joints_, "position", position_place_) &&
         find_places(command_interfaces_, joints_, "effort", effort_place_);
}

Controller::CallbackReturn Controller::on_activate(const rclcpp_lifecycle::State & /*previous_state*/)
{
  if (!order_interfaces()) {
    RCLCPP_ERROR(get_node()->get_logger(), "joints: an interface position or effort of %s is missing",
      joined(joints_).c_str());
    return CallbackReturn::ERROR;
  }
  const Vector position = positions();
  Vector torque = commands();  // what acts now, if the interface tells
  for (auto & value : torque) {
    value = std::isfinite(value) ? value : 0.0;
  }
  if (!law_.reset(position, torque)) {
    RCLCPP_ERROR(get_node()->get_logger(), "position: a joint has none yet; activate once all are measured");
    return CallbackReturn::ERROR;
  }
  is_in_fault_ = is_timed_ = false;
  flags_ = 0;
  follower_.hold(position);
  if (!set_reference({position, {}, {}})) {
    RCLCPP_ERROR(get_node()->get_logger(), "reference: its interfaces are missing or busy; activate again");
    return CallbackReturn::ERROR;
  }
  return CallbackReturn::SUCCESS;
}

Controller::CallbackReturn Controller::on_deactivate(const rclcpp_lifecycle::State & /*previous_state*/)
{
  if (!write({})) {
    RCLCPP_ERROR(get_node()->get_logger(), "effort: an interface did not take the zero of the end");
  }
  return CallbackReturn::SUCCESS;
}

#if TARC_UPDATE_REFERENCE_HAS_TIME
controller_interface::return_type Controller::update_reference_from_subscribers(
  const rclcpp::Time & /*time*/, const rclcpp::Duration & /*period*/)
#else
controller_interface::return_type Controller::update_reference_from_subscribers()
#endif
{
  set_reference(follower_.next());  // a value that is not set stays that of the period before
  return controller_interface::return_type::OK;
}

controller_interface::return_type Controller::update_and_write_commands(
  const rclcpp::Time & time, const rclcpp::Duration & /*period*/)
{
  Vector torque;
  const double elapsed = is_timed_ ? 1e-9 * static_cast<double>(time.nanoseconds() - last_time_) : MISSING;
  last_time_ = time.nanoseconds();
  is_timed_ = true;
  const auto status = law_.step(positions(), reference(), commands(), elapsed, torque);
  if (status == ${NAME}_FAULT && !is_in_fault_) {
    RCLCPP_ERROR(
      get_node()->get_logger(), "%d samples missing in a row: the safe torque is applied until the next activation",
      law_.missing());
  }
  is_in_fault_ = status == ${NAME}_FAULT;
  if (law_.flags() & ~flags_) {
    RCLCPP_ERROR(get_node()->get_logger(), "left what was certified: flags %u of ${name}.h", law_.flags());
  }
  flags_ = law_.flags();
  write(torque);  // what an interface does not take, the next step reads back
  return controller_interface::return_type::OK;
}

Vector Controller::positions() const
{
  Vector result;
  for (std::size_t i = 0; i < JOINTS; ++i) {
    result[i] = value_of(state_interfaces_[position_place_[i]]);
  }
  return result;
}

Vector Controller::commands() const
{
  Vector result;
  for (std::size_t i = 0; i < JOINTS; ++i) {
    result[i] = value_of(command_interfaces_[effort_place_[i]]);
  }
  return result;
}

bool Controller::write(const Vector & torque)
{
  bool is_set = true;
  for (std::size_t i = 0; i < JOINTS; ++i) {
    is_set = set_value(command_interfaces_[effort_place_[i]], torque[i]) && is_set;
  }
  return is_set;
}

#if TARC_EXPORTS_LIST
std::vector<hardware_interface::CommandInterface::SharedPtr> Controller::on_export_reference_interfaces_list()
{
  references_.clear();
  for (const auto & name : joints_) {
    for (const auto quantity : QUANTITIES) {
      hardware_interface::InterfaceInfo info{};
      info.name = name + "/" + quantity;
      info.data_type = "double";
      references_.push_back(std::make_shared<hardware_interface::CommandInterface>(
        hardware_interface::InterfaceDescription(get_node()->get_name(), info)));
    }
  }
  return references_;
}

Reference Controller::reference() const
{
  Reference result;
  for (std::size_t i = 0; i < JOINTS; ++i) {
    result.position[i] = value_of(*references_[3 * i]);
    result.velocity[i] = value_of(*references_[3 * i + 1]);
    result.acceleration[i] = value_of(*references_[3 * i + 2]);
  }
  return result;
}

bool Controller::set_reference(const Reference & reference)
{
  bool is_set = references_.size() == 3 * JOINTS;  // or they were not exported yet
  if (!is_set) {
    return false;
  }
  for (std::size_t i = 0; i < JOINTS; ++i) {
    is_set = set_value(*references_[3 * i], reference.position[i]) && is_set;
    is_set = set_value(*references_[3 * i + 1], reference.velocity[i]) && is_set;
    is_set = set_value(*references_[3 * i + 2], reference.acceleration[i]) && is_set;
  }
  return is_set;
}
#else
std::vector<hardware_interface::CommandInterface> Controller::on_export_reference_interfaces()
{
  std::vector<hardware_interface::CommandInterface> result;
  reference_interfaces_.assign(3 * JOINTS, MISSING);
  result.reserve(3 * JOINTS);
  for (std::size_t i = 0; i < JOINTS; ++i) {
    for (std::size_t k = 0; k < 3; ++k) {
#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wdeprecated-declarations"
#endif
      result.emplace_back(get_node()->get_name(), joints_[i] + "/" + QUANTITIES[k], &reference_interfaces_[3 * i + k]);
#if defined(__GNUC__)
#pragma GCC diagnostic pop
#endif
    }
  }
  return result;
}

Reference Controller::reference() const
{
  Reference result;
  for (std::size_t i = 0; i < JOINTS; ++i) {
    result.position[i] = reference_interfaces_[3 * i];
    result.velocity[i] = reference_interfaces_[3 * i + 1];
    result.acceleration[i] = reference_interfaces_[3 * i + 2];
  }
  return result;
}

bool Controller::set_reference(const Reference & reference)
{
  if (reference_interfaces_.size() != 3 * JOINTS) {
    return false;  // they were not exported yet
  }
  for (std::size_t i = 0; i < JOINTS; ++i) {
    reference_interfaces_[3 * i] = reference.position[i];
    reference_interfaces_[3 * i + 1] = reference.velocity[i];
    reference_interfaces_[3 * i + 2] = reference.acceleration[i];
  }
  return true;
}
#endif
}  // namespace $package

PLUGINLIB_EXPORT_CLASS($package::Controller, controller_interface::ChainableControllerInterface)
""")
