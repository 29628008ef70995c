"""Files of a colcon package beside its C++: build, plugin description, parameters, launch and README."""

from string import Template

PACKAGE = Template("""<?xml version="1.0"?>
<?xml-model href="http://download.ros.org/schema/package_format3.xsd" schematypens="http://www.w3.org/2001/XMLSchema"?>
<package format="3">
  <name>$package</name>
  <version>$version</version>
  <description>$title, as a controller of ros2_control and as a node</description>
  <maintainer email="you@example.com">you</maintainer>
  <license file="LICENSE">$license</license>

  <buildtool_depend>ament_cmake</buildtool_depend>

  <depend>controller_interface</depend>
  <depend>hardware_interface</depend>
  <depend>pluginlib</depend>
  <depend>rclcpp</depend>
  <depend>rclcpp_lifecycle</depend>
  <depend>sensor_msgs</depend>
  <depend>std_msgs</depend>
  <depend>trajectory_msgs</depend>

  <exec_depend>controller_manager</exec_depend>
  <exec_depend>forward_command_controller</exec_depend>
  <exec_depend>joint_state_broadcaster</exec_depend>
  <exec_depend>joint_trajectory_controller</exec_depend>
  <exec_depend>launch_ros</exec_depend>
  <exec_depend>robot_state_publisher</exec_depend>
  <exec_depend>xacro</exec_depend>

  <export>
    <build_type>ament_cmake</build_type>
  </export>
</package>
""")

CMAKE = Template("""cmake_minimum_required(VERSION 3.16)
project($package LANGUAGES C CXX)

find_package(ament_cmake REQUIRED)
find_package(controller_interface REQUIRED)
find_package(hardware_interface REQUIRED)
find_package(pluginlib REQUIRED)
find_package(rclcpp REQUIRED)
find_package(rclcpp_lifecycle REQUIRED)
find_package(sensor_msgs REQUIRED)
find_package(std_msgs REQUIRED)
find_package(trajectory_msgs REQUIRED)

set(CMAKE_CXX_STANDARD 17)
set(CMAKE_CXX_STANDARD_REQUIRED ON)
if(NOT CMAKE_BUILD_TYPE)
  set(CMAKE_BUILD_TYPE Release)
endif()

# products and sums are rounded one by one, as where the law was simulated
add_library(${name}_law STATIC src/$name.c)
set_target_properties(${name}_law PROPERTIES
  C_STANDARD 99 C_STANDARD_REQUIRED ON C_EXTENSIONS OFF POSITION_INDEPENDENT_CODE ON)
target_compile_options(${name}_law PRIVATE -O2 -ffp-contract=off)
target_include_directories(${name}_law PUBLIC src)
target_link_libraries(${name}_law PUBLIC m)

add_library($package SHARED src/controller.cpp)
target_compile_options($package PRIVATE -Wall -Wextra -Wpedantic)
target_link_libraries($package PRIVATE
  ${name}_law
  controller_interface::controller_interface
  hardware_interface::hardware_interface
  pluginlib::pluginlib
  rclcpp::rclcpp
  rclcpp_lifecycle::rclcpp_lifecycle
  $${trajectory_msgs_TARGETS})
pluginlib_export_plugin_description_file(controller_interface $package.xml)

add_executable(${name}_node src/node_main.cpp)
target_compile_options(${name}_node PRIVATE -Wall -Wextra -Wpedantic)
target_link_libraries(${name}_node PRIVATE
  ${name}_law rclcpp::rclcpp $${sensor_msgs_TARGETS} $${std_msgs_TARGETS} $${trajectory_msgs_TARGETS})

install(TARGETS $package LIBRARY DESTINATION lib)
install(TARGETS ${name}_node DESTINATION lib/$package)
install(DIRECTORY config launch DESTINATION share/$package)
install(FILES law.yaml DESTINATION share/$package)

if(BUILD_TESTING)
  add_executable(${name}_replay test/replay.c)
  target_link_libraries(${name}_replay ${name}_law)
  add_test(NAME replay COMMAND ${name}_replay)
endif()

ament_package()
""")

PLUGIN = Template("""<library path="$package">
  <class name="$package/Controller" type="$package::Controller"
         base_class_type="controller_interface::ChainableControllerInterface">
    <description>$title</description>
  </class>
</library>
""")

PARAMETERS = Template("""# Parameters of the controller manager, of the law, and of what works beside it.
# The law's own are compiled into the C, and a change needs another export:
$law_parameters
controller_manager:
  ros__parameters:
    update_rate: $rate  # or a multiple of it
    joint_state_broadcaster:
      type: joint_state_broadcaster/JointStateBroadcaster
    $package:
      type: $package/Controller
    joint_trajectory_controller:
      type: joint_trajectory_controller/JointTrajectoryController
    effort_controller:  # for the node alone, in place of the two above
      type: forward_command_controller/ForwardCommandController

$package:
  ros__parameters:
    update_rate: $rate  # the law's; with another the controller does not configure
    prefix: ""  # of the robot's names for the joints
    joints: [$joints]  # in any order; they must be the law's

joint_trajectory_controller:
  ros__parameters:
    joints: [$joints]
    command_joints: [$command_joints]
    command_interfaces: [position, velocity, acceleration]  # the references of the law
    state_interfaces: [position]
    allow_nonzero_velocity_at_trajectory_end: false

effort_controller:
  ros__parameters:
    joints: [$joints]  # in the law's order: the node's commands have no names
    interface_name: effort

${name}_law:
  ros__parameters:
    update_rate: $rate
    prefix: ""
    command_topic: /effort_controller/commands
""")

LAUNCH = Template('''"""Start a simulated robot with the law and a joint trajectory controller ahead of it.

ros2 launch $package $name.launch.py robot:=/path/to/robot.urdf.xacro simulator:=mujoco

The robot's ros2_control tag names the hardware: mujoco_ros2_control/MujocoSystemInterface with the parameter
mujoco_model, or gz_ros2_control/GazeboSimSystem. Each joint needs the command interface effort and the state
interface position. With simulator:=none your own controller manager must run already.
"""

import os

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, OpaqueFunction
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import Command, LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterFile, ParameterValue
from launch_ros.substitutions import FindPackageShare

CONTROLLERS = ["joint_state_broadcaster", "$package", "joint_trajectory_controller"]


def simulator(context):
    chosen = LaunchConfiguration("simulator").perform(context)
    parameters = PathJoinSubstitution([FindPackageShare("$package"), "config", "$name.yaml"])
    if chosen == "none":
        return spawners(parameters)
    description = ParameterValue(Command(["xacro ", LaunchConfiguration("robot")]), value_type=str)
    robot = {"robot_description": description, "use_sim_time": True}
    nodes = [Node(package="robot_state_publisher", executable="robot_state_publisher", parameters=[robot])]
    if chosen == "mujoco":
        is_humble = os.environ.get("ROS_DISTRO") == "humble"
        nodes.append(
            Node(
                package="mujoco_ros2_control",
                executable="ros2_control_node",
                output="both",
                parameters=[{"use_sim_time": True}, ParameterFile(parameters)],
                remappings=[("~/robot_description", "/robot_description")] if is_humble else [],
            )
        )
    elif chosen == "gz":
        gz = PathJoinSubstitution([FindPackageShare("ros_gz_sim"), "launch", "gz_sim.launch.py"])
        arguments = {"gz_args": "-r empty.sdf"}.items()
        nodes.append(IncludeLaunchDescription(PythonLaunchDescriptionSource(gz), launch_arguments=arguments))
        create = ["-topic", "robot_description", "-name", "$name"]
        nodes.append(Node(package="ros_gz_sim", executable="create", arguments=create))
    else:
        raise RuntimeError(f"simulator: got {chosen!r}; needs mujoco, gz or none")
    return nodes + spawners(parameters)


def spawners(parameters):
    return [
        Node(package="controller_manager", executable="spawner", arguments=[*CONTROLLERS, "--param-file", parameters])
    ]


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument("robot", default_value="", description="URDF or xacro with a ros2_control tag"),
            DeclareLaunchArgument("simulator", default_value="mujoco", description="mujoco, gz or none"),
            OpaqueFunction(function=simulator),
        ]
    )
''')

README = Template("""# $title

A control law as a package of ROS 2, written by tarc-control $version.
Its parameters, and what is certified of it, are in `law.yaml`.

```console
$$ cp -r . ~/ws/src/$package && cd ~/ws && rosdep install --from-paths src -y && colcon build
$$ colcon test --packages-select $package
$$ ros2 launch $package $name.launch.py robot:=robot.urdf.xacro simulator:=mujoco
```

The joints, in the law's order: $joint_text. They are matched by name.
One step is $period s long, so that `update_rate` is $rate Hz; with another rate nothing configures.

## As a controller

`$package/Controller` is chainable. It reads `<joint>/position` and writes `<joint>/effort`.
A controller ahead of it writes `$package/<joint>/{position,velocity,acceleration}`; `config/$name.yaml` has a joint
trajectory controller for that. Without one it follows `~/joint_trajectory`, from the next period on.
It holds the position that it was activated at until then. At its end it writes zero torque: engage the brakes before.

The torque that the command interface really has, limited or kept from before, is what the law goes on from.

## As a node

`ros2 run $package ${name}_node` needs no controller but one that forwards efforts; `config/$name.yaml` has one.
It makes one step for each message on `/joint_states`, whose stamps are its clock. It starts once 20 of them came at the
law's rate. Periods without a message count as missing samples.

## What was tried

The C repeats recorded steps bit for bit: `tarc verify-export .` says so again.
The C++ was compiled against stubs of ros2_control with the signatures of 2.54, 4.21, 4.46, 5.16 and 6.8.
Stubs prove that it compiles and gives the law's torques, not that it works in ROS: try it in simulation first.
""")
