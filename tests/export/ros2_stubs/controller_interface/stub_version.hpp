// What differs between versions of ros2_control, as its history has it.
#pragma once
#define STUB_VERSION (1000 * STUB_MAJOR + STUB_MINOR)
#define STUB_HAS_LIST                                                                                                 \
  ((STUB_VERSION >= 4044 && STUB_VERSION < 5000) || (STUB_VERSION >= 5013 && STUB_VERSION < 6000) ||                  \
   STUB_VERSION >= 6005)
