# step_aside(<package>): let an installed copy of <package> win over the one in this workspace.
#
# Debian 12 ships none of these packages (control_msgs, gazebo_msgs, ...), so this workspace brings
# them. On a system that has them (a ROS built from source, a later Debian) ours would overlay the
# real ones, so they give way: a CATKIN_IGNORE file (not under version control) hides the package from
# catkin and from rospack, whatever an earlier build left in the devel space is removed, and the
# calling CMakeLists.txt ends there. Decided whenever CMake runs: when an installed copy comes or goes
# after the first build, delete the CATKIN_IGNORE files and run `catkin_make --force-cmake`; setup.sh
# notices and does both.
#
# "Installed" means a <package>Config.cmake where rospack looks too: in a sourced underlay or in /usr,
# never in our own devel or install space. The answer is left in <package>_STEPS_ASIDE.
function(step_aside package)
  set(${package}_STEPS_ASIDE FALSE PARENT_SCOPE)
  # catkin has turned the environment's path into this list; an isolated build may not have yet.
  string(REPLACE ":" ";" prefixes "${CMAKE_PREFIX_PATH};$ENV{CMAKE_PREFIX_PATH};/usr")
  foreach(prefix IN LISTS prefixes)
    if(prefix STREQUAL "" OR prefix STREQUAL "${CATKIN_DEVEL_PREFIX}"
       OR prefix STREQUAL "${CMAKE_INSTALL_PREFIX}")
      continue()
    endif()
    if(EXISTS "${prefix}/share/${package}/cmake/${package}Config.cmake")
      message(STATUS "${package}: using the one installed in ${prefix}, not the workspace's copy")
      file(TOUCH "${CMAKE_CURRENT_SOURCE_DIR}/CATKIN_IGNORE")
      file(REMOVE_RECURSE
        "${CATKIN_DEVEL_PREFIX}/bin/${package}"
        "${CATKIN_DEVEL_PREFIX}/share/${package}"
        "${CATKIN_DEVEL_PREFIX}/include/${package}"
        "${CATKIN_DEVEL_PREFIX}/lib/python3/dist-packages/${package}"
        "${CATKIN_DEVEL_PREFIX}/share/common-lisp/ros/${package}")
      set(${package}_STEPS_ASIDE TRUE PARENT_SCOPE)
      return()
    endif()
  endforeach()
endfunction()
