# version.cpp: program version and the commit of the tree, refreshed at every build, rewritten only when it changed.
set(PAVE_VERSION_SOURCE ${PROJECT_BINARY_DIR}/version.cpp)
add_custom_target(pave_version ALL
  COMMAND ${CMAKE_COMMAND} -DSOURCE_DIR=${PROJECT_SOURCE_DIR} -DOUTPUT=${PAVE_VERSION_SOURCE} -DVERSION=${PROJECT_VERSION}
    -P ${PROJECT_SOURCE_DIR}/cmake/write_version.cmake
  BYPRODUCTS ${PAVE_VERSION_SOURCE} VERBATIM)
