# start_nodes_with_this_python([PROGRAM ...]): the package's installed programs, and those named, start
# with the interpreter that the workspace was configured with. catkin_install_python(), to be called
# before, gives them `env python3`: the system's Python, which has no PyBullet.
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
