# SPDX-License-Identifier: Apache-2.0
# One export file per component, so that a consumer of core and vdb_io needs no Embree.
include(CMakePackageConfigHelpers)

set(_config_dir ${CMAKE_INSTALL_LIBDIR}/cmake/lumivdb)
foreach(name IN LISTS LUMIVDB_COMPONENTS)
  install(TARGETS lumivdb_${name} EXPORT lumivdb_${name}Targets
    ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR})
  install(EXPORT lumivdb_${name}Targets NAMESPACE lumivdb:: DESTINATION ${_config_dir})
  install(DIRECTORY ${name}/include/ DESTINATION ${CMAKE_INSTALL_INCLUDEDIR})
endforeach()
if(TARGET lumivdb_cli)
  install(TARGETS lumivdb_cli RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR})
  # What `lumivdb bench` measures where nothing is named.
  install(DIRECTORY ${PROJECT_SOURCE_DIR}/samples/
    DESTINATION ${CMAKE_INSTALL_DATADIR}/lumivdb/samples
    FILES_MATCHING PATTERN "*.glb" PATTERN "*.hdr")
endif()

configure_package_config_file(cmake/lumivdbConfig.cmake.in
  ${PROJECT_BINARY_DIR}/lumivdbConfig.cmake INSTALL_DESTINATION ${_config_dir})
write_basic_package_version_file(${PROJECT_BINARY_DIR}/lumivdbConfigVersion.cmake
  COMPATIBILITY SameMinorVersion)
install(FILES
  ${PROJECT_BINARY_DIR}/lumivdbConfig.cmake
  ${PROJECT_BINARY_DIR}/lumivdbConfigVersion.cmake
  cmake/Dependencies.cmake
  DESTINATION ${_config_dir})
