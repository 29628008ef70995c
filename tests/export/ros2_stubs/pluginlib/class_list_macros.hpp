#pragma once
#include <functional>
#include <map>
#include <memory>
#include <string>

#define STUB_JOIN(a, b) a##b
#define STUB_NAME(line) STUB_JOIN(stub_create_, line)

/// Of the stub: the loader calls this symbol with the name of a class, and gets an object of it or nothing.
#define PLUGINLIB_EXPORT_CLASS(Class, Base)                                  \
  extern "C" void * stub_create_plugin(const char * class_name);             \
  extern "C" void * stub_create_plugin(const char * class_name)              \
  {                                                                          \
    Base * const plugin = std::string(class_name) == #Class ? new Class : nullptr; \
    return plugin;                                                           \
  }
