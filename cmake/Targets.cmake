# SPDX-License-Identifier: Apache-2.0
# What all targets share.

add_library(lumivdb_options INTERFACE)
target_compile_options(lumivdb_options INTERFACE
  -Wall -Wextra -Wpedantic -Wshadow -Wno-unknown-pragmas
  # One rounding per operation whatever the compiler's mood: results must not depend on it.
  -ffp-contract=off
  $<$<BOOL:${LUMIVDB_WARNINGS_AS_ERRORS}>:-Werror>)
if(LUMIVDB_SANITIZE)
  # Without null, alignment and vptr: they more than double the time to compile OpenVDB's templates
  # (46 s against 20 s for one grid type); AddressSanitizer stops at null pointers too.
  target_compile_options(lumivdb_options INTERFACE
    -fsanitize=address,undefined -fno-sanitize=null,alignment,vptr
    -fno-sanitize-recover=undefined -fno-omit-frame-pointer
    -Wno-maybe-uninitialized) # GCC 12 gives it falsely in instrumented code of <functional>
  target_link_options(lumivdb_options INTERFACE -fsanitize=address,undefined)
endif()

# lumivdb_library(NAME sources…): static library lumivdb_NAME, exported as lumivdb::NAME, public
# headers below include/.
function(lumivdb_library name)
  add_library(lumivdb_${name} STATIC ${ARGN})
  add_library(lumivdb::${name} ALIAS lumivdb_${name})
  set_target_properties(lumivdb_${name} PROPERTIES EXPORT_NAME ${name})
  target_compile_features(lumivdb_${name} PUBLIC cxx_std_17)
  target_include_directories(lumivdb_${name}
    PUBLIC $<BUILD_INTERFACE:${CMAKE_CURRENT_SOURCE_DIR}/include>
           $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}>
    PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/src)
  target_link_libraries(lumivdb_${name} PRIVATE $<BUILD_INTERFACE:lumivdb_options>)
endfunction()
