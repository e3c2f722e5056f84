# start_nodes_with_this_python([PROGRAM ...]) makes the installed programs of the package, and the
# given ones, run with the Python interpreter that the workspace was configured with. Call it after
# catkin_install_python(), which selects `env python3`, i.e. the system's Python without PyBullet.
function(start_nodes_with_this_python)
  install(CODE "
    file(GLOB programs \"\$ENV{DESTDIR}\${CMAKE_INSTALL_PREFIX}/${CATKIN_PACKAGE_BIN_DESTINATION}/*\")
    foreach(program ${ARGN})
      list(APPEND programs \"\$ENV{DESTDIR}\${CMAKE_INSTALL_PREFIX}/\${program}\")
    endforeach()
    foreach(program \${programs})
      file(READ \"\${program}\" text)
      string(REGEX REPLACE \"^#![^\\n]*python[^\\n]*\" \"#!${PYTHON_EXECUTABLE}\" text \"\${text}\")
      file(WRITE \"\${program}\" \"\${text}\")
    endforeach()
  ")
endfunction()
