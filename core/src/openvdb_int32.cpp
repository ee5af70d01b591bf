// SPDX-License-Identifier: Apache-2.0
#define LUMIVDB_OPENVDB_DEFINE
#include <lumivdb/core/openvdb_instances.h>

LUMIVDB_OPENVDB_INSTANCE(, Int32Tree)
