# kernels.cpp: every file of kernels/ as bytes, so that the library carries its kernels with their own names and lines.
file(GLOB PAVE_KERNEL_FILES CONFIGURE_DEPENDS ${PROJECT_SOURCE_DIR}/kernels/*.cl ${PROJECT_SOURCE_DIR}/kernels/*.h)
set(PAVE_KERNELS_SOURCE ${PROJECT_BINARY_DIR}/kernels.cpp)
string(REPLACE ";" "|" PAVE_KERNEL_LIST "${PAVE_KERNEL_FILES}")
add_custom_command(OUTPUT ${PAVE_KERNELS_SOURCE}
  COMMAND ${CMAKE_COMMAND} "-DFILES=${PAVE_KERNEL_LIST}" -DOUTPUT=${PAVE_KERNELS_SOURCE} -P ${PROJECT_SOURCE_DIR}/cmake/embed_kernels.cmake
  DEPENDS ${PAVE_KERNEL_FILES} ${PROJECT_SOURCE_DIR}/cmake/embed_kernels.cmake VERBATIM)
