# report_stand_ins(): report the C++ targets of the calling directory that include headers of stand-in
# packages, which have no headers, and exclude these targets from the build.
function(report_stand_ins)
  set(names
    control_toolbox controller_interface controller_manager effort_controllers
    forward_command_controller gazebo gazebo_dev gazebo_plugins gazebo_ros gazebo_ros_control
    gazebo_ros_pkgs gripper_action_controller hardware_interface joint_limits_interface
    joint_state_controller joint_trajectory_controller position_controllers realtime_tools
    ros_control ros_controllers transmission_interface velocity_controllers
  )
  string(REPLACE ";" "|" pattern "${names}")
  file(GLOB_RECURSE headers "${CMAKE_CURRENT_SOURCE_DIR}/include/*.h*")
  get_property(targets DIRECTORY PROPERTY BUILDSYSTEM_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(type ${target} TYPE)
    if(NOT type MATCHES "EXECUTABLE|(STATIC|SHARED|MODULE|OBJECT)_LIBRARY")
      continue()
    endif()
    get_target_property(sources ${target} SOURCES)
    set(included "")
    foreach(file IN LISTS sources headers)
      get_filename_component(file "${file}" ABSOLUTE BASE_DIR "${CMAKE_CURRENT_SOURCE_DIR}")
      if(EXISTS "${file}" AND NOT IS_DIRECTORY "${file}")
        file(STRINGS "${file}" lines REGEX "^[ \t]*#[ \t]*include[ \t]*[<\"](${pattern})/")
        foreach(line IN LISTS lines)
          string(REGEX REPLACE "^[^<\"]*[<\"]([a-z_]+)/.*$" "\\1" name "${line}")
          list(APPEND included ${name})
        endforeach()
      endif()
    endforeach()
    if(included)
      list(REMOVE_DUPLICATES included)
      string(REPLACE ";" ", " included "${included}")
      message(NOTICE "${PROJECT_NAME}: ${target} is not built: it includes C++ headers of ${included}, \
which aras_sim_bridge does not contain; write it in Python, or build these packages in an underlay")
      set_property(TARGET ${target} PROPERTY EXCLUDE_FROM_ALL TRUE)
    endif()
  endforeach()
endfunction()

# Call report_stand_ins at the end of the caller's CMakeLists.txt, when all targets are known.
get_property(report_stand_ins_due DIRECTORY PROPERTY report_stand_ins_due)
if(NOT report_stand_ins_due)
  set_property(DIRECTORY PROPERTY report_stand_ins_due TRUE)
  cmake_language(DEFER CALL report_stand_ins)
endif()
