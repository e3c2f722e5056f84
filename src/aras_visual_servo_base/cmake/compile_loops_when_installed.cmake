# compile_loops_when_installed(): the package's loops (Numba) are compiled when it is installed, or taken over
# from its sources where they are compiled already; the first start would wait for that otherwise. To be called
# after catkin_python_setup(). Packages that are not installed yet are imported from beside this one's sources.
function(compile_loops_when_installed)
  file(GLOB beside "${CMAKE_CURRENT_SOURCE_DIR}/../*/src")
  string(REPLACE ";" ":" beside "${beside}")
  install(CODE "
    message(STATUS \"Compiling loops of ${PROJECT_NAME}\")
    set(libraries \"\$ENV{DESTDIR}\${CMAKE_INSTALL_PREFIX}/${CATKIN_GLOBAL_PYTHON_DESTINATION}:${beside}\")
    execute_process(
      COMMAND \"${CMAKE_COMMAND}\" -E env \"PYTHONPATH=\${libraries}\" \"${PYTHON_EXECUTABLE}\"
        -m aras_visual_servo_base.compile_packages --from \"${CMAKE_CURRENT_SOURCE_DIR}/src\" ${PROJECT_NAME}
      WORKING_DIRECTORY /
      RESULT_VARIABLE failed)
    if(failed)
      message(WARNING \"Loops of ${PROJECT_NAME} are not compiled: the first start does it, and takes a minute.\")
    endif()
  ")
endfunction()
