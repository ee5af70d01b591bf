// SPDX-License-Identifier: Apache-2.0
#include "scene_fixture.h"

#include <OpenImageIO/imageio.h>

#include <atomic>
#include <fstream>
#include <random>
#include <sstream>
#include <stdexcept>

namespace scene_test {

namespace fs = std::filesystem;

namespace {

std::string join(const std::vector<std::string>& parts)
{
    std::string result;
    for (const std::string& part : parts) result += (result.empty() ? "" : ",") + part;
    return result;
}

void appendWord(std::string& out, std::size_t value)
{
    for (int shift = 0; shift < 32; shift += 8) out += static_cast<char>((value >> shift) & 255);
}

std::string encode(
    const std::string& name, const OIIO::ImageSpec& spec, OIIO::TypeDesc format, const void* pixels)
{
    const TempFolder folder;
    const std::string path = folder.path(name);
    const auto output = OIIO::ImageOutput::create(path);
    if (!output || !output->open(path, spec) || !output->write_image(format, pixels)
        || !output->close()) {
        throw std::runtime_error("cannot write " + name);
    }
    std::ifstream file(fs::u8path(path), std::ios::binary);
    std::ostringstream bytes;
    bytes << file.rdbuf();
    return bytes.str();
}

} // namespace

const std::vector<float> kTriangle = {0, 0, 0, 1, 0, 0, 0, 1, 0};

TempFolder::TempFolder()
{
    static std::atomic<int> number{0};
    std::ostringstream name;
    name << "lumivdb-scene-" << std::random_device()() << "-" << number++;
    mFolder = fs::temp_directory_path() / name.str();
    fs::create_directories(mFolder);
}

TempFolder::~TempFolder()
{
    std::error_code ignored;
    fs::remove_all(mFolder, ignored);
}

std::string TempFolder::path(const std::string& name) const
{
    return (mFolder / fs::u8path(name)).u8string();
}

std::string TempFolder::write(const std::string& name, const std::string& bytes) const
{
    const fs::path file = mFolder / fs::u8path(name);
    fs::create_directories(file.parent_path());
    std::ofstream(file, std::ios::binary) << bytes;
    return file.u8string();
}

std::string base64(const std::string& bytes)
{
    const char* digits = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    std::string result;
    for (std::size_t i = 0; i < bytes.size(); i += 3) {
        std::uint32_t group = 0;
        for (std::size_t k = 0; k < 3; ++k) {
            const bool inside = i + k < bytes.size();
            group = group << 8 | (inside ? static_cast<unsigned char>(bytes[i + k]) : 0u);
        }
        for (std::size_t k = 0; k < 4; ++k) {
            const bool padding = i + k > bytes.size();
            result += padding ? '=' : digits[(group >> (18 - 6 * k)) & 63];
        }
    }
    return result;
}

std::string png(int width, int height, int channels, const std::vector<std::uint8_t>& pixels)
{
    OIIO::ImageSpec spec(width, height, channels, OIIO::TypeDesc::UINT8);
    spec["oiio:UnassociatedAlpha"] = 1;
    return encode("image.png", spec, OIIO::TypeDesc::UINT8, pixels.data());
}

std::string encodeImage(
    const std::string& extension, int width, int height, const std::vector<float>& pixels)
{
    const auto stored = extension == "exr" ? OIIO::TypeDesc::FLOAT : OIIO::TypeDesc::UINT16;
    const OIIO::ImageSpec spec(width, height, 3, stored);
    return encode("image." + extension, spec, OIIO::TypeDesc::FLOAT, pixels.data());
}

int GltfBuilder::view(const std::string& bytes, int stride)
{
    mBytes.resize((mBytes.size() + 3) / 4 * 4);
    std::ostringstream json;
    json << R"({"buffer":0,"byteOffset":)" << mBytes.size() << R"(,"byteLength":)" << bytes.size();
    if (stride > 0) json << R"(,"byteStride":)" << stride;
    json << "}";
    mBytes += bytes;
    mViews.push_back(json.str());
    return static_cast<int>(mViews.size()) - 1;
}

int GltfBuilder::accessor(
    int bufferView, int componentType, int count, const std::string& type, const std::string& more)
{
    std::ostringstream json;
    json << "{";
    if (bufferView >= 0) json << R"("bufferView":)" << bufferView << ",";
    json << R"("componentType":)" << componentType << R"(,"count":)" << count << R"(,"type":")"
         << type << "\"" << (more.empty() ? "" : ",") << more << "}";
    mAccessors.push_back(json.str());
    return static_cast<int>(mAccessors.size()) - 1;
}

int GltfBuilder::vec3(const std::vector<float>& values)
{
    return accessor(view(bytesOf(values)), 5126, static_cast<int>(values.size() / 3), "VEC3");
}

int GltfBuilder::vec2(const std::vector<float>& values)
{
    return accessor(view(bytesOf(values)), 5126, static_cast<int>(values.size() / 2), "VEC2");
}

int GltfBuilder::indices(const std::vector<std::uint16_t>& values)
{
    return accessor(view(bytesOf(values)), 5123, static_cast<int>(values.size()), "SCALAR");
}

std::string GltfBuilder::arrays() const
{
    std::string result = R"("asset":{"version":"2.0"})";
    if (!mViews.empty()) result += R"(,"bufferViews":[)" + join(mViews) + "]";
    if (!mAccessors.empty()) result += R"(,"accessors":[)" + join(mAccessors) + "]";
    return result;
}

std::string GltfBuilder::gltf(const std::string& rest) const
{
    std::string result = "{" + arrays();
    if (!mBytes.empty()) {
        result += R"(,"buffers":[{"byteLength":)" + std::to_string(mBytes.size())
            + R"(,"uri":"data:application/octet-stream;base64,)" + base64(mBytes) + "\"}]";
    }
    return result + (rest.empty() ? "" : ",") + rest + "}";
}

std::string GltfBuilder::glb(const std::string& rest) const
{
    std::string bin = mBytes;
    bin.resize((bin.size() + 3) / 4 * 4);
    return glbFile("{" + arrays() + R"(,"buffers":[{"byteLength":)" + std::to_string(bin.size())
            + "}]" + (rest.empty() ? "" : ",") + rest + "}",
        bin);
}

std::string glbFile(const std::string& json, const std::string& bin)
{
    std::string text = json;
    while (text.size() % 4 != 0) text += ' ';
    std::string result = "glTF";
    appendWord(result, 2);
    appendWord(result, 12 + 8 + text.size() + (bin.empty() ? 0 : 8 + bin.size()));
    appendWord(result, text.size());
    result += "JSON" + text;
    if (!bin.empty()) {
        appendWord(result, bin.size());
        result += std::string("BIN\0", 4) + bin;
    }
    return result;
}

std::string triangleGltf(GltfBuilder& builder, const std::string& primitive,
    const std::string& rest, const std::string& node)
{
    const int positions = builder.vec3(kTriangle);
    std::string members = primitive;
    // "attributes" of the caller come inside the braces, the others behind them.
    std::string attributes = R"("POSITION":)" + std::to_string(positions);
    const std::string mark = "attributes:";
    if (members.compare(0, mark.size(), mark) == 0) {
        const auto end = members.find('|');
        attributes += "," + members.substr(mark.size(), end - mark.size());
        members = end == std::string::npos ? "" : members.substr(end + 1);
    }
    return builder.gltf(R"("meshes":[{"name":"tri","primitives":[{"attributes":{)" + attributes
        + "}" + (members.empty() ? "" : ",") + members + R"(}]}],"nodes":[{)" + node
        + R"(}],"scenes":[{"nodes":[0]}],"scene":0)" + (rest.empty() ? "" : ",") + rest);
}

lumivdb::Scene load(const TempFolder& folder, const std::string& text)
{
    return lumivdb::loadScene(folder.write("scene.gltf", text));
}

int countWarnings(const lumivdb::Scene& scene, const std::string& text)
{
    int count = 0;
    for (const std::string& warning : scene.warnings) {
        if (warning.find(text) != std::string::npos) ++count;
    }
    return count;
}

lumivdb::Vec3d normalOf(const lumivdb::Mesh& mesh, std::size_t triangle)
{
    const auto& t = mesh.triangles.at(triangle);
    const auto& a = mesh.positions.at(t[0]);
    return (mesh.positions.at(t[1]) - a).cross(mesh.positions.at(t[2]) - a);
}

} // namespace scene_test
