# compile_loops_when_installed(): compile the package's Numba functions when the package is installed, or copy
# them from its sources if they are compiled already. Otherwise the first start of a program compiles them.
# Call this after catkin_python_setup(). Packages that are not installed yet are imported from the folders next
# to this package.
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
      message(WARNING \"The Numba functions of ${PROJECT_NAME} were not compiled. The first start compiles them, which takes a minute.\")
    endif()
  ")
endfunction()
