# Run by the target pave_version.
execute_process(COMMAND git -C ${SOURCE_DIR} describe --always --abbrev=12 --exclude=* --dirty=+
  OUTPUT_VARIABLE commit OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET)
if(NOT commit)
  set(commit unknown)
endif()
set(text "// Written by cmake/write_version.cmake.\n#include \"pave/version.h\"\n\nnamespace pave {\nstd::string program_version() { return \"${VERSION}\"; }\nstd::string program_commit() { return \"${commit}\"; }\n}  // namespace pave\n")
if(EXISTS ${OUTPUT})
  file(READ ${OUTPUT} old)
endif()
if(NOT "${old}" STREQUAL "${text}")
  file(WRITE ${OUTPUT} "${text}")
endif()
