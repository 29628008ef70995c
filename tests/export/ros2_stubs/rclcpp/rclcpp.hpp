#pragma once
#include <any>
#include <chrono>
#include <cstdarg>
#include <cstdint>
#include <cstdio>
#include <functional>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace rclcpp
{
class Time
{
public:
  explicit Time(std::int64_t nanoseconds = 0) : nanoseconds_(nanoseconds) {}
  std::int64_t nanoseconds() const { return nanoseconds_; }

private:
  std::int64_t nanoseconds_;
};

class Duration
{
public:
  explicit Duration(std::int64_t nanoseconds) : nanoseconds_(nanoseconds) {}
  double seconds() const { return 1e-9 * static_cast<double>(nanoseconds_); }

private:
  std::int64_t nanoseconds_;
};

class QoS
{
public:
  explicit QoS(std::size_t depth) : depth_(depth) {}
  std::size_t depth_;
};

class NodeOptions
{
};

class Logger
{
};

class Parameter
{
public:
  explicit Parameter(std::any value) : value_(std::move(value)) {}
  std::string as_string() const { return std::any_cast<std::string>(value_); }
  std::vector<std::string> as_string_array() const { return std::any_cast<std::vector<std::string>>(value_); }

private:
  std::any value_;
};

/// Of the stub: what callers gave, and callbacks by topic.
struct StubWorld
{
  std::map<std::string, std::any> parameters, callbacks, published;
  std::function<void()> timer;
  std::string last_error;
  std::map<std::string, int> n_published;
};

inline StubWorld & stub_world()
{
  static StubWorld world;
  return world;
}

inline void stub_error(const Logger &, const char * format, ...) __attribute__((format(printf, 2, 3)));
inline void stub_error(const Logger &, const char * format, ...)
{
  char text[2000];
  std::va_list arguments;
  va_start(arguments, format);
  std::vsnprintf(text, sizeof text, format, arguments);
  va_end(arguments);
  stub_world().last_error = text;
}

template <typename Message>
class Subscription
{
public:
  using SharedPtr = std::shared_ptr<Subscription<Message>>;
};

template <typename Message>
class Publisher
{
public:
  explicit Publisher(std::string topic) : topic_(std::move(topic)) {}
  using SharedPtr = std::shared_ptr<Publisher<Message>>;
  void publish(const Message & message)
  {
    stub_world().published[topic_] = message;
    ++stub_world().n_published[topic_];
  }

private:
  std::string topic_;
};

class TimerBase
{
public:
  using SharedPtr = std::shared_ptr<TimerBase>;
};

class Node
{
public:
  explicit Node(const std::string & name, const NodeOptions & = NodeOptions()) : name_(name) {}
  virtual ~Node() = default;
  const char * get_name() const { return name_.c_str(); }
  Logger get_logger() const { return Logger(); }

  template <typename T>
  T declare_parameter(const std::string & name, const T & value)
  {
    auto & parameters = stub_world().parameters;
    if (parameters.count(name) == 0) {
      parameters[name] = value;
    }
    return std::any_cast<T>(parameters[name]);
  }

  Parameter get_parameter(const std::string & name) const { return Parameter(stub_world().parameters.at(name)); }

  template <typename Message, typename Callback>
  typename Subscription<Message>::SharedPtr create_subscription(
    const std::string & topic, const QoS &, Callback && callback)
  {
    using Function = std::function<void(std::shared_ptr<const Message>)>;
    stub_world().callbacks[topic] = Function(std::forward<Callback>(callback));
    return std::make_shared<Subscription<Message>>();
  }

  template <typename Message>
  typename Publisher<Message>::SharedPtr create_publisher(const std::string & topic, const QoS &)
  {
    return std::make_shared<Publisher<Message>>(topic);
  }

  template <typename Rep, typename Period, typename Callback>
  TimerBase::SharedPtr create_wall_timer(std::chrono::duration<Rep, Period>, Callback && callback)
  {
    stub_world().timer = std::forward<Callback>(callback);
    return std::make_shared<TimerBase>();
  }

private:
  std::string name_;
};

inline void init(int, char **) {}
inline void spin(const std::shared_ptr<Node> &) {}
inline bool shutdown() { return true; }
}  // namespace rclcpp

#define RCLCPP_ERROR(logger, ...) rclcpp::stub_error(logger, __VA_ARGS__)
