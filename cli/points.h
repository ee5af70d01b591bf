// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file points.h
/// Points in, rows out: the CSV and JSON of query and probe.

#include "common.h"

#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace lumivdb::cli {

struct PointList {
    std::vector<Vec3d> positions;
    std::vector<Vec3f> normals; ///< unit; empty, or one per position
};

/// Reads "x,y,z" or "x,y,z,nx,ny,nz" lines from @a path ("-": standard input). Blank lines and
/// lines that begin with # are skipped. A first line of column names is allowed and then says which
/// columns count, so what query prints can be read again. Normals are normalised.
/// @throws Error(Input) naming file, line and thing.
PointList readPoints(const std::string& path);

/// Collects rows of named numbers and writes them as CSV and as a JSON array of objects.
class RowWriter {
public:
    /// @a csv, @a json which of the two forms are wanted.
    RowWriter(std::vector<std::string> columns, bool csv, bool json);
    /// One value per column; @a more is added to the JSON object only.
    void add(
        const std::vector<double>& values, const std::vector<std::pair<std::string, Json>>& more);
    void add(const std::vector<double>& values);
    /// CSV to standard output, JSON to @a jsonPath.
    void finish(const std::string& jsonPath);

private:
    void addCsv(const std::vector<double>& values);

    std::vector<std::string> mColumns;
    bool mCsv, mJson;
    std::size_t mRows = 0;
    std::string mCsvText, mJsonText;
};

/// Appends "sh_0_r", "sh_0_g", … for @a coefficients coefficients.
void appendShColumns(std::vector<std::string>& columns, int coefficients);
/// Appends the numbers of those columns.
void appendShValues(std::vector<double>& values, const Color* sh, int coefficients);

} // namespace lumivdb::cli
