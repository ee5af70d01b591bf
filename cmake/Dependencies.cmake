# SPDX-License-Identifier: Apache-2.0
# Every package LumiVDB is made of; versions are those of Debian 12. Included by the project itself
# and, installed, by lumivdbConfig.cmake, so that consumers get the same targets.
#
# Set LUMIVDB_WITH_BAKE before to find what the bake component links too.

# Here a missing package is an error; for a consumer it makes find_package(lumivdb) fail or not be
# found, as the consumer asked.
macro(lumivdb_dependency)
  if(CMAKE_FIND_PACKAGE_NAME)
    find_dependency(${ARGN})
  else()
    find_package(${ARGN} REQUIRED)
  endif()
endmacro()

include(CMakeFindDependencyMacro)
lumivdb_dependency(Threads)
lumivdb_dependency(Imath CONFIG)
lumivdb_dependency(TBB CONFIG)
lumivdb_dependency(hwy CONFIG)

# Debian keeps OpenVDB's find module outside CMake's search path.
set(_lumivdb_module_path ${CMAKE_MODULE_PATH})
list(APPEND CMAKE_MODULE_PATH "/usr/lib/${CMAKE_LIBRARY_ARCHITECTURE}/cmake/OpenVDB")
lumivdb_dependency(OpenVDB)
set(CMAKE_MODULE_PATH ${_lumivdb_module_path})

if(LUMIVDB_WITH_BAKE)
  lumivdb_dependency(embree 3.13 CONFIG)
  lumivdb_dependency(OpenImageIO CONFIG)
  # Debian's exported target names /usr/include/opencv4, which its packages do not install.
  get_target_property(_lumivdb_includes OpenImageIO::OpenImageIO INTERFACE_INCLUDE_DIRECTORIES)
  set(_lumivdb_existing "")
  foreach(_lumivdb_dir IN LISTS _lumivdb_includes)
    if(EXISTS "${_lumivdb_dir}")
      list(APPEND _lumivdb_existing "${_lumivdb_dir}")
    endif()
  endforeach()
  set_target_properties(OpenImageIO::OpenImageIO PROPERTIES
    INTERFACE_INCLUDE_DIRECTORIES "${_lumivdb_existing}")
  lumivdb_dependency(TinyGLTF CONFIG)
  lumivdb_dependency(assimp CONFIG)
endif()
