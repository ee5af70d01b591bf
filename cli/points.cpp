// SPDX-License-Identifier: Apache-2.0
#include "points.h"

#include "numbers.h"
#include "output.h"

#include <nlohmann/json.hpp>

#include <algorithm>
#include <array>
#include <cmath>

namespace lumivdb::cli {

namespace {

/// Reads the lines of one file; remembers where it is for messages.
class PointReader {
public:
    explicit PointReader(const std::string& path)
        : mPath(path == "-" ? "standard input" : "'" + path + "'")
    {
    }
    PointList read(std::string_view text);

private:
    void readLine(std::string_view line);
    bool readHeader(const std::vector<std::string_view>& fields);
    void readFirst(const std::vector<std::string_view>& fields);
    void addPoint(const std::vector<std::string_view>& fields);
    void addNormal(const Vec3d& n);
    [[noreturn]] void fail(const std::string& what) const
    {
        throw Error(ErrorCode::Input, mPath + " line " + std::to_string(mLine) + ": " + what + ".");
    }

    std::string mPath;
    std::size_t mLine = 0;
    std::size_t mFields = 0; // in a line; 0: no line read yet
    std::vector<std::size_t> mColumns; // of x, y, z and maybe nx, ny, nz
    PointList mPoints;
};

PointList PointReader::read(std::string_view text)
{
    constexpr std::string_view kByteOrderMark = "\xEF\xBB\xBF";
    if (text.substr(0, 3) == kByteOrderMark) text.remove_prefix(3);
    while (!text.empty()) {
        const std::size_t end = text.find('\n');
        ++mLine;
        const std::string_view line = trimmed(text.substr(0, end));
        if (!line.empty() && line[0] != '#') readLine(line);
        text.remove_prefix(end == std::string_view::npos ? text.size() : end + 1);
    }
    return std::move(mPoints);
}

void PointReader::readLine(std::string_view line)
{
    const std::vector<std::string_view> fields = split(line, ',');
    if (mFields == 0) {
        const bool header = readHeader(fields);
        if (!header) readFirst(fields);
        mFields = fields.size();
        if (header) return;
    }
    if (fields.size() != mFields) {
        fail(std::to_string(fields.size()) + " values where the lines before have "
            + std::to_string(mFields) + "; give every line the same columns");
    }
    addPoint(fields);
}

bool PointReader::readHeader(const std::vector<std::string_view>& fields)
{
    std::vector<std::string> names;
    for (const std::string_view field : fields) {
        std::string name(field);
        std::transform(name.begin(), name.end(), name.begin(),
            [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
        names.push_back(name);
    }
    std::vector<std::size_t> columns;
    for (const char* wanted : {"x", "y", "z", "nx", "ny", "nz"}) {
        const auto found = std::find(names.begin(), names.end(), wanted);
        if (found != names.end()) {
            columns.push_back(static_cast<std::size_t>(found - names.begin()));
        }
    }
    if (columns.empty()) return false;
    if (columns.size() != 3 && columns.size() != 6) {
        fail("the column names lack some of x,y,z or nx,ny,nz; name three or six");
    }
    mColumns = columns;
    return true;
}

void PointReader::readFirst(const std::vector<std::string_view>& fields)
{
    if (fields.size() != 3 && fields.size() != 6) {
        fail(std::to_string(fields.size()) + " values; give x,y,z or x,y,z,nx,ny,nz");
    }
    for (std::size_t i = 0; i < fields.size(); ++i) mColumns.push_back(i);
}

void PointReader::addPoint(const std::vector<std::string_view>& fields)
{
    std::array<double, 6> values{};
    for (std::size_t i = 0; i < mColumns.size(); ++i) {
        const std::string_view field = fields[mColumns[i]];
        const auto value = parseReal(field);
        if (!value) {
            fail("'" + std::string(field.substr(0, 40))
                + "' is not a finite number; give x,y,z "
                  "or x,y,z,nx,ny,nz");
        }
        values[i] = *value;
    }
    mPoints.positions.emplace_back(values[0], values[1], values[2]);
    if (mColumns.size() == 6) addNormal(Vec3d(values[3], values[4], values[5]));
}

void PointReader::addNormal(const Vec3d& n)
{
    const double largest = std::max({std::abs(n.x), std::abs(n.y), std::abs(n.z)});
    if (!(largest > 0)) fail("the normal 0,0,0 has no direction; give one of any length above 0");
    mPoints.normals.emplace_back((n / largest).normalized());
}

} // namespace

PointList readPoints(const std::string& path) { return PointReader(path).read(readText(path)); }

RowWriter::RowWriter(std::vector<std::string> columns, bool csv, bool json)
    : mColumns(std::move(columns))
    , mCsv(csv)
    , mJson(json)
{
    for (const std::string& column : mColumns) {
        if (mCsv) mCsvText += (mCsvText.empty() ? "" : ",") + column;
    }
    if (mCsv) mCsvText += "\n";
    if (mJson) mJsonText = "[";
}

void RowWriter::add(const std::vector<double>& values) { add(values, {}); }

void RowWriter::add(
    const std::vector<double>& values, const std::vector<std::pair<std::string, Json>>& more)
{
    ++mRows;
    if (mCsv) addCsv(values);
    if (!mJson) return;
    Json row;
    for (std::size_t i = 0; i < values.size(); ++i) {
        if (mColumns[i] == "level") {
            row[mColumns[i]] = static_cast<int>(values[i]);
        } else {
            row[mColumns[i]] = values[i];
        }
    }
    for (const auto& [name, value] : more) row[name] = value;
    mJsonText += (mRows > 1 ? ",\n" : "\n") + row.dump();
}

void RowWriter::addCsv(const std::vector<double>& values)
{
    constexpr std::size_t kFlushBytes = 1 << 20;
    for (std::size_t i = 0; i < values.size(); ++i) {
        if (i > 0) mCsvText += ',';
        appendNumber(mCsvText, values[i]);
    }
    mCsvText += '\n';
    if (mCsvText.size() < kFlushBytes) return;
    writeStdout(mCsvText);
    mCsvText.clear();
}

void RowWriter::finish(const std::string& jsonPath)
{
    if (mCsv) writeStdout(mCsvText);
    if (mJson) writeText(jsonPath, mJsonText + "\n]\n");
}

void appendShColumns(std::vector<std::string>& columns, int coefficients)
{
    for (int i = 0; i < coefficients; ++i) {
        for (const char* channel : {"_r", "_g", "_b"}) {
            columns.push_back("sh_" + std::to_string(i) + channel);
        }
    }
}

void appendShValues(std::vector<double>& values, const Color* sh, int coefficients)
{
    for (int i = 0; i < coefficients; ++i) {
        for (int channel = 0; channel < 3; ++channel) {
            values.push_back(jsonNumber(sh[i][channel]));
        }
    }
}

} // namespace lumivdb::cli
