#pragma once
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "controller_interface/stub_version.hpp"
#include "hardware_interface/handle.hpp"
#include "rclcpp_lifecycle/lifecycle_node.hpp"

namespace controller_interface
{
using CallbackReturn = rclcpp_lifecycle::node_interfaces::LifecycleNodeInterface::CallbackReturn;

enum class return_type : std::uint8_t { OK = 0, ERROR = 1 };
enum class interface_configuration_type : std::uint8_t { ALL = 0, INDIVIDUAL = 1, NONE = 2 };

struct InterfaceConfiguration
{
#if STUB_VERSION < 4000
  interface_configuration_type type;
#else
  interface_configuration_type type = interface_configuration_type::NONE;
#endif
  std::vector<std::string> names = {};
};

class ControllerInterfaceBase : public rclcpp_lifecycle::node_interfaces::LifecycleNodeInterface
{
public:
  virtual InterfaceConfiguration command_interface_configuration() const = 0;
  virtual InterfaceConfiguration state_interface_configuration() const = 0;
  virtual CallbackReturn on_init() = 0;
  virtual return_type update(const rclcpp::Time & time, const rclcpp::Duration & period) = 0;
  std::shared_ptr<rclcpp_lifecycle::LifecycleNode> get_node() { return node_; }
  std::shared_ptr<rclcpp_lifecycle::LifecycleNode> get_node() const { return node_; }
  unsigned int get_update_rate() const { return update_rate_; }

  template <typename T>
  auto auto_declare(const std::string & name, const T & value)
  {
    return get_node()->template declare_parameter<T>(name, value);
  }

  void assign_interfaces(
    std::vector<hardware_interface::LoanedCommandInterface> && commands,
    std::vector<hardware_interface::LoanedStateInterface> && states)
  {
    command_interfaces_ = std::move(commands);
    state_interfaces_ = std::move(states);
  }

  // of the stub
  void stub_init(const std::string & name, unsigned int rate)
  {
    node_ = std::make_shared<rclcpp_lifecycle::LifecycleNode>(name);
    update_rate_ = rate;
    on_init();
  }

protected:
  std::vector<hardware_interface::LoanedCommandInterface> command_interfaces_;
  std::vector<hardware_interface::LoanedStateInterface> state_interfaces_;

private:
  std::shared_ptr<rclcpp_lifecycle::LifecycleNode> node_;
  unsigned int update_rate_ = 0;
};

class ChainableControllerInterface : public ControllerInterfaceBase
{
public:
  return_type update(const rclcpp::Time & time, const rclcpp::Duration & period) final
  {
    if (!stub_is_chained) {
#if STUB_VERSION >= 3012
      const auto result = update_reference_from_subscribers(time, period);
#else
      const auto result = update_reference_from_subscribers();
#endif
      if (result != return_type::OK) {
        return result;
      }
    }
    return update_and_write_commands(time, period);
  }

  // of the stub
  bool stub_is_chained = false;
#if STUB_HAS_LIST
  std::vector<hardware_interface::CommandInterface::SharedPtr> stub_references()
  {
    return on_export_reference_interfaces_list();
  }
#else
  std::vector<std::shared_ptr<hardware_interface::CommandInterface>> stub_references()
  {
    std::vector<std::shared_ptr<hardware_interface::CommandInterface>> result;
    for (auto & interface : on_export_reference_interfaces()) {
      result.push_back(std::make_shared<hardware_interface::CommandInterface>(std::move(interface)));
    }
    return reference_interfaces_.size() == result.size() ? result : decltype(result)();
  }
#endif

protected:
#if STUB_HAS_LIST
  [[deprecated("Replaced by on_export_reference_interfaces_list()")]]
  virtual std::vector<hardware_interface::CommandInterface> on_export_reference_interfaces()
  {
    return {};
  }
  virtual std::vector<hardware_interface::CommandInterface::SharedPtr> on_export_reference_interfaces_list()
  {
    return {};
  }
#elif STUB_VERSION >= 4000
  virtual std::vector<hardware_interface::CommandInterface> on_export_reference_interfaces() { return {}; }
#else
  virtual std::vector<hardware_interface::CommandInterface> on_export_reference_interfaces() = 0;
#endif
#if STUB_VERSION >= 3012
  virtual return_type update_reference_from_subscribers(
    const rclcpp::Time & time, const rclcpp::Duration & period) = 0;
#else
  virtual return_type update_reference_from_subscribers() = 0;
#endif
  virtual return_type update_and_write_commands(const rclcpp::Time & time, const rclcpp::Duration & period) = 0;

  std::vector<double> reference_interfaces_;
};
}  // namespace controller_interface
