# What `cmake --install` and the wheel put where. C++ users get find_package(pave) -> pave::pave; the wheel gets one folder.
if(PAVE_WHEEL)
  # pave/_pave*.so, pave/libpave.so and pave/scenes; ADIOS2's own wheel is unpacked beside that folder.
  set_target_properties(pave PROPERTIES INSTALL_RPATH "$ORIGIN;$ORIGIN/../adios2")
  install(TARGETS pave _pave LIBRARY DESTINATION pave COMPONENT python)
  install(DIRECTORY scenes/ DESTINATION pave/scenes COMPONENT python)
  return()
endif()

include(CMakePackageConfigHelpers)
set(package_dir ${CMAKE_INSTALL_LIBDIR}/cmake/pave)
# ADIOS2's libraries stay where its Python package is; installed programs find them there through libpave.so.
set_target_properties(pave PROPERTIES VERSION ${PROJECT_VERSION} SOVERSION 0 INSTALL_RPATH "$ORIGIN;${PAVE_ADIOS2_DIR}")
install(TARGETS pave EXPORT pave-targets LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR} COMPONENT development)
install(DIRECTORY host/include/pave staging/include/pave DESTINATION ${CMAKE_INSTALL_INCLUDEDIR} COMPONENT development
  FILES_MATCHING PATTERN "*.h")
install(DIRECTORY scenes/ DESTINATION ${CMAKE_INSTALL_DATADIR}/pave/scenes COMPONENT development)
install(EXPORT pave-targets NAMESPACE pave:: DESTINATION ${package_dir} COMPONENT development)
configure_package_config_file(cmake/pave-config.cmake.in ${PROJECT_BINARY_DIR}/pave-config.cmake INSTALL_DESTINATION ${package_dir})
write_basic_package_version_file(${PROJECT_BINARY_DIR}/pave-config-version.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${PROJECT_BINARY_DIR}/pave-config.cmake ${PROJECT_BINARY_DIR}/pave-config-version.cmake
  DESTINATION ${package_dir} COMPONENT development)
