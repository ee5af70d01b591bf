// SPDX-License-Identifier: Apache-2.0
#include "scene_import.h"

#include "texture.h"

#include <lumivdb/core/error.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>

namespace lumivdb {

namespace {

constexpr std::size_t kNamesPerWarning = 4;
/// Triangles of the world are numbered in 32 bits, one number of which means none.
constexpr std::uint64_t kMaxTriangles = 0xfffffffe;
/// Of those in memory, so that it stays thinkable.
constexpr std::uint64_t kMaxStored = std::uint64_t(1) << 28;
/// Transforms of less relative volume make a sheet, a line or a point of their mesh.
constexpr double kFlat = 1e-9;

bool isFinite(const Vec3d& p)
{
    // Embree works in single precision: beyond its range a position is as good as infinite.
    return std::isfinite(static_cast<float>(p.x)) && std::isfinite(static_cast<float>(p.y))
        && std::isfinite(static_cast<float>(p.z));
}

/// Zero area up to the rounding of double precision.
bool isDegenerate(const Vec3d& a, const Vec3d& b, const Vec3d& c)
{
    const Vec3d ab = b - a, ac = c - a, bc = c - b;
    const double longest = std::max({ab.length2(), ac.length2(), bc.length2()});
    return !(ab.cross(ac).length() > 1e-14 * longest);
}

/// Determinant of the linear part over the product of the lengths of its rows; 0 where it is flat.
double relativeVolume(const Mat4d& m)
{
    const Vec3d x(m[0][0], m[0][1], m[0][2]), y(m[1][0], m[1][1], m[1][2]);
    const Vec3d z(m[2][0], m[2][1], m[2][2]);
    const double lengths = x.length() * y.length() * z.length();
    return lengths > 0 ? x.cross(y).dot(z) / lengths : 0;
}

Mat4d absolute(Mat4d m)
{
    for (int i = 0; i < 4; ++i) {
        for (int j = 0; j < 4; ++j) m[i][j] = std::abs(m[i][j]);
    }
    return m;
}

/// Tracers look up uv of every textured hit; a mesh without any samples texel (0, 0).
void fillMissingUvs(SceneImport& import)
{
    for (Mesh& mesh : import.scene.meshes) {
        const Material& material = import.scene.materials[static_cast<std::size_t>(mesh.material)];
        for (const TextureSlot* slot : {&material.baseColorTexture, &material.emissionTexture}) {
            if (slot->texture < 0) continue;
            std::vector<Vec2f>& uv = mesh.uv[slot->uvSet];
            if (!uv.empty() || mesh.positions.empty()) continue;
            uv.assign(mesh.positions.size(), Vec2f(0, 0));
            import.warnings.add("Textured meshes lack the texture coordinates that their material "
                                "asks for, so they have the colour of one texel",
                mesh.name);
        }
    }
}

/// Floating-point images can hold reflectances above 1: clamp a copy for the base colour.
void clampBaseColorTextures(SceneImport& import)
{
    Scene& scene = import.scene;
    std::vector<int> clamped(scene.textures.size(), -2); // −2: not looked at yet
    for (Material& material : scene.materials) {
        int& slot = material.baseColorTexture.texture;
        if (slot < 0) continue;
        const std::size_t source = static_cast<std::size_t>(slot);
        if (clamped[source] == -2) {
            clamped[source] = slot;
            const std::vector<float>& p = scene.textures[source].pixels;
            if (std::any_of(p.begin(), p.end(), [](float v) { return v > 1.0f; })) {
                Texture copy = scene.textures[source];
                for (float& v : copy.pixels) v = std::min(v, 1.0f);
                clamped[source] = static_cast<int>(scene.textures.size());
                scene.textures.push_back(std::move(copy));
                import.warnings.add("Base colour textures above 1 are clamped to 1", material.name);
            }
        }
        slot = clamped[source];
    }
}

void checkFinite(const SceneImport& import, const LocalMesh& source)
{
    Vec3d largest(0.0); // of each coordinate's magnitudes
    const auto check = [&](std::size_t vertex, const Vec3d& p) {
        if (isFinite(p)) return;
        import.fail("mesh '" + source.name + "' vertex "
            + std::to_string(source.sourceVertex[vertex])
            + " has a position that is not finite; repair the mesh");
    };
    for (std::size_t i = 0; i < source.positions.size(); ++i) {
        const Vec3d& p = source.positions[i];
        check(i, p);
        for (int a = 0; a < 3; ++a) largest[a] = std::max(largest[a], std::abs(p[a]));
    }
    for (const auto& places : source.places) {
        for (const Mat4d& place : places) {
            // Where the largest that could come out is finite, nobody needs to look closer.
            if (isFinite(transformAffine(absolute(place), largest))) continue;
            for (std::size_t i = 0; i < source.positions.size(); ++i) {
                check(i, transformAffine(place, source.positions[i]));
            }
        }
    }
}

/// All of @a source but its triangles, in its own space.
Mesh withoutTriangles(const LocalMesh& source)
{
    Mesh mesh;
    mesh.name = source.name;
    mesh.material = source.material;
    mesh.positions = source.positions;
    for (int set = 0; set < 2; ++set) mesh.uv[set] = source.uv[set];
    mesh.colors = source.colors;
    return mesh;
}

/// Gives @a mesh the triangles of @a source that have an area, before and after it was placed, and
/// adds it to the scene.
void addMesh(SceneImport& import, const LocalMesh& source, bool mirrored, Mesh&& mesh)
{
    const auto &own = source.positions, &placed = mesh.positions;
    mesh.triangles.reserve(source.triangles.size());
    for (const auto& t : source.triangles) {
        if (isDegenerate(own[t[0]], own[t[1]], own[t[2]])
            || isDegenerate(placed[t[0]], placed[t[1]], placed[t[2]])) {
            ++import.degenerate;
            continue;
        }
        mesh.triangles.push_back(mirrored ? std::array<std::uint32_t, 3>{t[0], t[2], t[1]} : t);
    }
    import.stored += mesh.triangles.size();
    if (import.stored > kMaxStored) {
        import.fail(
            "it has more than " + std::to_string(kMaxStored) + " triangles; bake parts of it");
    }
    if (!mesh.triangles.empty()) import.scene.meshes.push_back(std::move(mesh));
}

void addPlaced(SceneImport& import, const LocalMesh& source, const Mat4d& toWorld)
{
    Mesh mesh = withoutTriangles(source);
    for (Vec3d& p : mesh.positions) p = transformAffine(toWorld, p);
    addMesh(import, source, relativeVolume(toWorld) < 0, std::move(mesh));
}

void addInstanced(SceneImport& import, const LocalMesh& source, bool mirrored)
{
    Mesh mesh = withoutTriangles(source);
    mesh.instances = source.places[mirrored ? 1 : 0];
    addMesh(import, source, mirrored, std::move(mesh));
}

bool isBlack(const Color& c) { return c.x <= 0 && c.y <= 0 && c.z <= 0; }

bool emitsLight(const Scene& scene)
{
    for (const Light& light : scene.lights) {
        if (!isBlack(light.intensity)) return true;
    }
    return std::any_of(scene.meshes.begin(), scene.meshes.end(), [&](const Mesh& mesh) {
        const Material& m = scene.materials[static_cast<std::size_t>(mesh.material)];
        return !mesh.triangles.empty() && !isBlack(m.emission);
    });
}

} // namespace

void WarningList::add(const std::string& sentence) { add(sentence, {}); }

void WarningList::add(const std::string& sentence, const std::string& item)
{
    auto it = std::find_if(
        mEntries.begin(), mEntries.end(), [&](const Entry& e) { return e.sentence == sentence; });
    if (it == mEntries.end()) it = mEntries.insert(mEntries.end(), Entry{sentence, {}, {}});
    if (item.empty() || !it->seen.insert(item).second) return;
    if (it->items.size() < kNamesPerWarning) it->items.push_back(item);
}

std::vector<std::string> WarningList::sentences() const
{
    std::vector<std::string> result;
    for (const Entry& entry : mEntries) {
        std::string text = entry.sentence;
        for (std::size_t i = 0; i < entry.items.size(); ++i) {
            text += (i == 0 ? ": " : ", ") + entry.items[i];
        }
        if (entry.seen.size() > entry.items.size()) {
            text += " and " + std::to_string(entry.seen.size() - entry.items.size()) + " more";
        }
        result.push_back(text + ".");
    }
    return result;
}

void SceneImport::fail(const std::string& what) const
{
    throw Error(ErrorCode::Input, path + ": " + what + ".");
}

void placeMesh(SceneImport& import, std::size_t mesh, const Mat4d& toWorld)
{
    LocalMesh& source = import.meshes[mesh];
    import.triangles += source.triangles.size();
    if (import.triangles > kMaxTriangles) {
        import.fail("it has more than " + std::to_string(kMaxTriangles)
            + " triangles, those of instances counted each time; bake parts of it");
    }
    const double volume = relativeVolume(toWorld);
    const int kind = std::abs(volume) > kFlat ? (volume < 0 ? 1 : 0) : 2;
    source.places[kind].push_back(toWorld);
}

void finishMeshes(SceneImport& import)
{
    for (LocalMesh& source : import.meshes) {
        checkFinite(import, source);
        for (int kind = 0; kind < 2; ++kind) {
            if (source.places[kind].size() == 1) addPlaced(import, source, source.places[kind][0]);
            if (source.places[kind].size() > 1) addInstanced(import, source, kind == 1);
        }
        for (const Mat4d& place : source.places[2]) addPlaced(import, source, place);
        source = LocalMesh(); // scenes are large: nothing stays twice
    }
}

Color clampReflectance(SceneImport& import, const Color& factor, const std::string& material)
{
    Color result = factor;
    for (int c = 0; c < 3; ++c) {
        if (!std::isfinite(factor[c])) import.fail("material '" + material + "' is not finite");
        result[c] = std::clamp(factor[c], 0.0f, 1.0f);
    }
    if (result != factor) {
        import.warnings.add("Base colours outside 0…1 are clamped", material);
    }
    return result;
}

int defaultMaterial(SceneImport& import, const std::string& mesh)
{
    import.warnings.add("Geometry without a material gets albedo 1", mesh);
    if (import.noMaterial < 0) {
        import.noMaterial = static_cast<int>(import.scene.materials.size());
        import.scene.materials.emplace_back();
        import.scene.materials.back().name = "(no material)";
    }
    return import.noMaterial;
}

int addTexture(
    SceneImport& import, Texture&& texture, const TextureDecode& decoded, const std::string& name)
{
    if (!decoded.ok) {
        import.warnings.add(
            "Textures that cannot be read are taken as white", name + " (" + decoded.reason + ")");
        return -1;
    }
    if (decoded.repaired) {
        import.warnings.add("NaN, infinite or negative texels are taken as 0", name);
    }
    import.scene.textures.push_back(std::move(texture));
    return static_cast<int>(import.scene.textures.size()) - 1;
}

void finishImport(SceneImport& import)
{
    Scene& scene = import.scene;
    if (scene.materials.empty()) {
        scene.materials.emplace_back();
        scene.materials.back().name = "(no material)";
    }
    fillMissingUvs(import);
    clampBaseColorTextures(import);
    if (import.degenerate > 0) {
        import.warnings.add(
            std::to_string(import.degenerate) + " degenerate triangles (zero area) are dropped");
    }
    if (scene.meshes.empty()) import.warnings.add("The scene has no triangles");
    if (!emitsLight(scene)) {
        import.warnings.add("Nothing emits light: without an environment the scene is black");
    }
    scene.warnings = import.warnings.sentences();
    updateContentHash(scene);
}

std::vector<unsigned char> readFileBytes(const std::string& path)
{
    const auto fail
        = [&](const std::string& what) { throw Error(ErrorCode::Input, path + ": " + what + "."); };
    const std::filesystem::path file = std::filesystem::u8path(path);
    std::error_code status;
    if (!std::filesystem::exists(file, status)) fail("there is no such file; check the path");
    if (!std::filesystem::is_regular_file(file, status))
        fail("it is not a file; name a scene file");
    const auto size = std::filesystem::file_size(file, status);
    std::ifstream stream(file, std::ios::binary);
    if (status || !stream) fail("it cannot be opened; check its permissions");
    std::vector<unsigned char> bytes(size);
    if (size > 0) stream.read(reinterpret_cast<char*>(bytes.data()), std::streamsize(size));
    if (!stream) fail("it cannot be read to its end");
    return bytes;
}

} // namespace lumivdb
