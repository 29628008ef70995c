#pragma once
#include <memory>
#include <optional>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

#include "controller_interface/stub_version.hpp"

namespace hardware_interface
{
#if STUB_VERSION < 4018
class CommandInterface
{
public:
  CommandInterface(const std::string & prefix, const std::string & name, double * value = nullptr)
  : prefix_(prefix), name_(name), value_(value)
  {
  }
  CommandInterface(const CommandInterface &) = delete;
  CommandInterface(CommandInterface &&) = default;
  const std::string get_name() const { return prefix_ + "/" + name_; }
  const std::string & get_prefix_name() const { return prefix_; }
  double get_value() const { return *value_; }
  void set_value(double value) { *value_ = value; }

private:
  std::string prefix_, name_;
  double * value_;
};
using StateInterface = CommandInterface;
#else
struct InterfaceInfo
{
  std::string name;
  std::string min = "";
  std::string max = "";
  std::string initial_value = "";
  std::string data_type = "double";
  int size;
  std::unordered_map<std::string, std::string> parameters;
  bool enable_limits;
};

struct InterfaceDescription
{
  InterfaceDescription(const std::string & prefix, const InterfaceInfo & info)
  : prefix_name(prefix), interface_info(info)
  {
  }
  std::string prefix_name;
  InterfaceInfo interface_info;
};

class Handle
{
public:
  [[deprecated("Use InterfaceDescription for initializing the Interface")]] Handle(
    const std::string & prefix, const std::string & name, double * value)
  : prefix_(prefix), name_(name), value_(value)
  {
  }
  explicit Handle(const InterfaceDescription & description)
  : prefix_(description.prefix_name), name_(description.interface_info.name)
  {
  }
  std::string get_name() const { return prefix_ + "/" + name_; }
  const std::string & get_prefix_name() const { return prefix_; }
#if STUB_VERSION >= 4027
  template <typename T = double>
  [[nodiscard]] std::optional<T> get_optional() const
  {
    return is_busy ? std::nullopt : std::optional<T>(value_ ? *value_ : own_);
  }
#else
  double get_value() const { return value_ ? *value_ : own_; }
#endif
  template <typename T>
#if STUB_VERSION >= 4020
  [[nodiscard]] bool
#else
  void
#endif
  set_value(const T & value)
  {
    if (!is_busy) {
      (value_ ? *value_ : own_) = value;
    }
#if STUB_VERSION >= 4020
    return !is_busy;
#endif
  }
  bool is_busy = false;  // of the stub: another thread has the lock

private:
  std::string prefix_, name_;
  double * value_ = nullptr;
  double own_ = 0.0;
};

class StateInterface : public Handle
{
public:
  using Handle::Handle;
  using SharedPtr = std::shared_ptr<StateInterface>;
};

class CommandInterface : public Handle
{
public:
  using Handle::Handle;
  CommandInterface(const CommandInterface &) = delete;
  CommandInterface(CommandInterface &&) = default;
  using SharedPtr = std::shared_ptr<CommandInterface>;
};
#endif

template <typename Interface>
class Loaned
{
public:
  explicit Loaned(Interface & interface) : interface_(interface) {}
  Loaned(const Loaned &) = delete;
  Loaned(Loaned &&) = default;
  std::string get_name() const { return interface_.get_name(); }
#if STUB_VERSION >= 4027
  template <typename T = double>
  [[nodiscard]] std::optional<T> get_optional(unsigned int max_tries = 10) const
  {
    return max_tries ? interface_.template get_optional<T>() : std::nullopt;
  }
#endif
#if STUB_VERSION < 4027
  double get_value() const { return interface_.get_value(); }
#elif STUB_VERSION < 6000
  [[deprecated("Use std::optional<T> get_optional() instead")]] double get_value() const
  {
    return get_optional().value();
  }
#endif
#if STUB_VERSION < 4018
  void set_value(double value) { interface_.set_value(value); }
#elif STUB_VERSION < 4020
  void set_value(double value) { interface_.set_value(value); }
#else
  template <typename T>
  [[nodiscard]] bool set_value(const T & value, unsigned int max_tries = 10)
  {
    return max_tries && interface_.set_value(value);
  }
#endif

private:
  Interface & interface_;
};
using LoanedCommandInterface = Loaned<CommandInterface>;
using LoanedStateInterface = Loaned<StateInterface>;
}  // namespace hardware_interface
