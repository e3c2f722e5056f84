# step_aside(<package>): use an installed copy of <package> instead of the one in this workspace.
#
# Debian 12 does not contain these packages (control_msgs, gazebo_msgs, ...). Therefore this workspace
# provides them. On a system that has them (a ROS built from source, a later Debian), the workspace's
# copies would overlay the installed ones. In this case, a CATKIN_IGNORE file (not under version
# control) hides the workspace's package from catkin and rospack, files of an earlier build are removed
# from the devel space, and <package>_STEPS_ASIDE is set to TRUE, so that the calling CMakeLists.txt
# can return. The check is done whenever CMake runs. If a package is installed or removed after the
# first build, delete the CATKIN_IGNORE files and run `catkin_make --force-cmake`; setup.sh detects
# this and does both.
#
# A package counts as installed if its <package>Config.cmake is in a sourced underlay or in /usr, where
# rospack searches, too. The devel and install spaces of this workspace do not count.
function(step_aside package)
  set(${package}_STEPS_ASIDE FALSE PARENT_SCOPE)
  # Read the environment variable, too: in an isolated build, catkin may not have set the list yet.
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
