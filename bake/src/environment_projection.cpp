// SPDX-License-Identifier: Apache-2.0
//
// The layouts. All images are seen from inside the sphere, none is mirrored. In each, u ∈ [0,1]
// runs to the right and v ∈ [0,1] downwards from the upper left corner of the image.
//
// Lat-long (any aspect; 2:1 is found by Auto). d = (sin πv·cos φ, cos πv, sin πv·sin φ) with
//   φ = 2π(u − ½): the centre looks along +X, a quarter to the right of it along +Z, a quarter
//   to the left along −Z, the left and right edges along −X; the top row is +Y, the bottom row −Y.
//   dω = 2π² sin πv du dv.
//
// Angular map (1:1), Debevec's "light probe image". With X = 2u − 1, Y = 1 − 2v and
//   r = √(X² + Y²) ≤ 1: the angle from −Z is πr, d = (X/r·sin πr, Y/r·sin πr, −cos πr). The centre
//   looks along −Z, +X is half-way to the right rim, +Y half-way to the upper rim, the whole rim is
//   +Z, and what lies outside the disc is not used. dω = π sin(πr)/r dX dY.
//
// Cube cross: six square faces, each with in-face coordinates a (right) and b (up) ∈ [−1,1] and
//   d ∝ n + a·right + b·up; dω = (1 + a² + b²)^(−3/2) da db.
//
//   vertical, 3:4                horizontal, 4:3
//       .  +Y   .                    .  +Y   .   .
//      −X  −Z  +X                   −X  −Z  +X  +Z
//       .  −Y   .                    .  −Y   .   .
//       .  +Z*  .
//
//   face   n   right  up      The arms fold towards the viewer, who looks along −Z at the centre.
//   −Z    −Z    +X    +Y      The last face of the vertical cross (*) hangs below −Y and is
//   −X    −X    −Z    +Y      therefore upside down: turned by 180° against the horizontal one, as
//   +X    +X    +Z    +Y      in Debevec's files.
//   +Y    +Y    +X    +Z      (OpenGL's cube maps are left-handed: there the centre is called
//   −Y    −Y    +X    −Z      GL_TEXTURE_CUBE_MAP_POSITIVE_Z; it is the same picture.)
//   +Z    +Z    −X    +Y
//   +Z*   +Z    +X    −Y
//
// Sources: P. Debevec, "Light Probe Image Gallery" (the angular map's formula). A cube texel's
// solid angle is closed: ∂²/∂a∂b atan(ab/√(1+a²+b²)) = (1+a²+b²)^(−3/2).
#include "environment_projection.h"

#include "directions.h"

#include <lumivdb/core/error.h>

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>

namespace lumivdb::detail {

namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr float kPiF = 3.14159265358979323846f;

/// floor(x) inside [0, n−1]; NaN gives 0.
int clampIndex(double x, int n) { return x > 0.0 ? static_cast<int>(std::min(x, n - 1.0)) : 0; }

/// Angle of (x, y) from +x towards +y in (−π, π], to 2e-5.
float roughAngle(float x, float y)
{
    const float ax = std::abs(x), ay = std::abs(y), most = std::max(ax, ay);
    const float octant = most > 0 ? kPiF / 2 * quarterTurns(std::min(ax, ay) / most) : 0.0f;
    const float quadrant = ay > ax ? kPiF / 2 - octant : octant;
    return std::copysign(x < 0 ? kPiF - quadrant : quadrant, y);
}

/// Nodes and weights on [0,1]; weights add up to 1.
struct Rule {
    std::vector<double> x, w;
};

/// Gauss–Legendre, repeated so often that a piece of @a angle radians resolves degree 5:
/// two points err by (5h)⁴/4320, three by (5h)⁶/2016000, relative to the integral.
Rule ruleFor(double angle)
{
    const double a3 = std::sqrt(0.15), a2 = std::sqrt(1.0 / 12.0);
    const bool fine = angle < 0.01;
    const std::vector<double> x = fine ? std::vector<double>{0.5 - a2, 0.5 + a2}
                                       : std::vector<double>{0.5 - a3, 0.5, 0.5 + a3};
    const std::vector<double> w
        = fine ? std::vector<double>{0.5, 0.5} : std::vector<double>{5.0 / 18, 8.0 / 18, 5.0 / 18};
    const int pieces = fine ? 1 : static_cast<int>(std::ceil(angle / 0.1));
    Rule rule;
    for (int i = 0; i < pieces; ++i) {
        for (std::size_t k = 0; k < x.size(); ++k) {
            rule.x.push_back((i + x[k]) / pieces);
            rule.w.push_back(w[k] / pieces);
        }
    }
    return rule;
}

/// Equal sectors of a circle, or of part of it. Angles count from +x towards +y.
class Sectors {
public:
    Sectors(double first, double angle, int count)
        : mFirst(static_cast<float>(first))
        , mPerAngle(static_cast<float>(count / angle))
        , mStep(angle / count)
        , mCount(count)
    {
        const auto direction = [](double a) { return Vec2d(std::cos(a), std::sin(a)); };
        for (int i = 0; i <= count; ++i) mEdges.push_back(direction(first + angle * i / count));
        for (int i = 0; i < count; ++i) {
            mMiddles.push_back(direction(first + angle * (i + 0.5) / count));
        }
    }

    /// The sector that (x, y), of any length, lies in: exactly that between its edges.
    int find(double x, double y) const
    {
        const auto edge = [&](int i) { return mEdges[static_cast<std::size_t>(i)]; };
        const auto before = [&](int i) { return edge(i).x * y < edge(i).y * x; };
        const float angle = roughAngle(static_cast<float>(x), static_cast<float>(y));
        int i = clampIndex((angle - mFirst) * mPerAngle, mCount);
        while (i > 0 && before(i)) --i;
        while (i + 1 < mCount && !before(i + 1)) ++i;
        return i;
    }

    /// Cosine and sine of edge @a i.
    Vec2d edge(int i) const { return mEdges[static_cast<std::size_t>(i)]; }

    /// Cosine and sine of the angle at @a t ∈ [0,1] of sector @a i.
    Vec2d inside(int i, double t) const
    {
        const double a = (t - 0.5) * mStep, a2 = a * a;
        double c, s;
        if (mStep < 0.1) { // Taylor, to rounding
            c = 1 - a2 / 2 * (1 - a2 / 12 * (1 - a2 / 30));
            s = a * (1 - a2 / 6 * (1 - a2 / 20 * (1 - a2 / 42)));
        } else {
            c = std::cos(a);
            s = std::sin(a);
        }
        const Vec2d& m = mMiddles[static_cast<std::size_t>(i)];
        return {m.x * c - m.y * s, m.y * c + m.x * s};
    }

private:
    float mFirst, mPerAngle;
    double mStep;
    int mCount;
    std::vector<Vec2d> mEdges, mMiddles;
};

class LatLong final : public ImageProjection {
public:
    LatLong(int w, int h)
        : ImageProjection(w, h)
        , mColumns(-kPi, 2 * kPi, w)
        , mRows(0, kPi, h)
        , mRuleU(ruleFor(2 * kPi / w))
        , mRuleV(ruleFor(kPi / h))
    {
        // cos a − cos b as a product, which keeps its digits at the poles.
        for (int y = 0; y < h; ++y)
            mSolidAngle.push_back(
                4 * kPi / w * std::sin(kPi * (y + 0.5) / h) * std::sin(0.5 * kPi / h));
        for (const double angle : mSolidAngle) mDensity.push_back(1 / angle);
    }

    Texel texelAt(const Vec3d& d) const override
    {
        return {mColumns.find(d.x, d.z), mRows.find(d.y, std::sqrt(d.x * d.x + d.z * d.z))};
    }

    /// Uniform in solid angle: in φ and in cos θ, not in v.
    bool pointIn(Texel texel, double s, double t, Vec3d& d) const override
    {
        const double top = mRows.edge(texel.y).x, bottom = mRows.edge(texel.y + 1).x;
        const double cosTheta = top + t * (bottom - top);
        const double sinTheta = std::sqrt(std::max(0.0, (1 - cosTheta) * (1 + cosTheta)));
        const Vec2d phi = mColumns.inside(texel.x, s);
        d = Vec3d(sinTheta * phi.x, cosTheta, sinTheta * phi.y);
        return true;
    }

    double pointDensity(Texel texel, const Vec3d&) const override
    {
        return mDensity[static_cast<std::size_t>(texel.y)];
    }

    double solidAngle(Texel texel) const override { return mSolidAngle[texel.y]; }

    void quadrature(Texel texel, std::vector<SphereNode>& nodes) const override
    {
        nodes.clear();
        const double area = 2 * kPi / width * kPi / height;
        for (std::size_t j = 0; j < mRuleV.x.size(); ++j) {
            const double theta = kPi * (texel.y + mRuleV.x[j]) / height;
            const double s = std::sin(theta), c = std::cos(theta);
            for (std::size_t i = 0; i < mRuleU.x.size(); ++i) {
                const double phi = 2 * kPi * ((texel.x + mRuleU.x[i]) / width - 0.5);
                nodes.push_back({Vec3d(s * std::cos(phi), c, s * std::sin(phi)),
                    area * s * mRuleU.w[i] * mRuleV.w[j]});
            }
        }
    }

private:
    Sectors mColumns, mRows; // of longitudes and of angles from +Y
    Rule mRuleU, mRuleV;
    std::vector<double> mSolidAngle, mDensity; // of a texel of each row, and its inverse
};

class AngularMap final : public ImageProjection {
public:
    explicit AngularMap(int size)
        : ImageProjection(size, size)
        , mRule(ruleFor(2 * kPi / size))
        , mRimStrips(ruleFor(std::max(2 * kPi / size, 0.75)))
        , mRimPieces(ruleFor(std::max(2 * kPi / size, 0.15)))
        , mSolidAngle(static_cast<std::size_t>(size) * size)
    {
        tbb::parallel_for(0, size, [&](int y) {
            std::vector<SphereNode> nodes;
            for (int x = 0; x < size; ++x) {
                quadrature({x, y}, nodes);
                double sum = 0;
                for (const SphereNode& node : nodes) sum += node.weight;
                mSolidAngle[static_cast<std::size_t>(y) * size + x] = sum;
            }
        });
    }

    Texel texelAt(const Vec3d& d) const override
    {
        const double sine = std::sqrt(d.x * d.x + d.y * d.y);
        const double r = std::atan2(sine, -d.z) / kPi;
        const double X = sine > 0 ? r * d.x / sine : r;
        const double Y = sine > 0 ? r * d.y / sine : 0.0;
        return {
            clampIndex(0.5 * (1 + X) * width, width), clampIndex(0.5 * (1 - Y) * height, height)};
    }

    bool pointIn(Texel texel, double s, double t, Vec3d& d) const override
    {
        return fromDisc(discX(texel.x + s), -discX(texel.y + t), d);
    }

    double pointDensity(Texel, const Vec3d& d) const override
    {
        // dω/dXdY = π sin(πr)/r with πr the angle from −Z; it vanishes at the rim, where the
        // single direction +Z is kept finite. A texel is (2/size)² of dXdY.
        const double sine = std::sqrt(d.x * d.x + d.y * d.y);
        const double angle = std::atan2(sine, -d.z);
        const double jacobian = angle > 1e-8 ? kPi * kPi * sine / angle : kPi * kPi;
        return 0.25 * width * height / std::max(jacobian, 1e-12);
    }

    double solidAngle(Texel texel) const override
    {
        return mSolidAngle[static_cast<std::size_t>(texel.y) * width + texel.x];
    }

    void quadrature(Texel texel, std::vector<SphereNode>& nodes) const override
    {
        nodes.clear();
        const double x0 = discX(texel.x), x1 = discX(texel.x + 1);
        const double y0 = -discX(texel.y + 1), y1 = -discX(texel.y);
        const double nearX = std::max({x0, -x1, 0.0}), nearY = std::max({y0, -y1, 0.0});
        const double farX = std::max(-x0, x1), farY = std::max(-y0, y1);
        if (nearX * nearX + nearY * nearY >= 1.0) return;
        const bool rim = farX * farX + farY * farY > 1.0;
        const Rule& ruleY = rim ? mRimStrips : mRule;
        for (std::size_t j = 0; j < ruleY.x.size(); ++j) {
            const double Y = y0 + (y1 - y0) * ruleY.x[j];
            // The disc cuts a horizontal line exactly, so only the strips approximate the rim.
            const double half = rim ? std::sqrt(std::max(0.0, 1.0 - Y * Y)) : 2.0;
            const double left = std::max(x0, -half), right = std::min(x1, half);
            if (left < right)
                addLine(left, right, Y, (y1 - y0) * ruleY.w[j], rim ? mRimPieces : mRule, nodes);
        }
    }

private:
    double discX(double pixel) const { return 2 * pixel / width - 1; }

    static bool fromDisc(double X, double Y, Vec3d& d)
    {
        const double r = std::sqrt(X * X + Y * Y);
        const double scale = r > 0 ? std::sin(kPi * r) / r : kPi;
        d = Vec3d(X * scale, Y * scale, -std::cos(kPi * r));
        return r <= 1.0;
    }

    static void addLine(double left, double right, double Y, double thickness, const Rule& rule,
        std::vector<SphereNode>& nodes)
    {
        for (std::size_t i = 0; i < rule.x.size(); ++i) {
            const double X = left + (right - left) * rule.x[i];
            Vec3d d;
            fromDisc(X, Y, d);
            const double r = std::sqrt(X * X + Y * Y);
            const double jacobian = r > 0 ? kPi * std::sin(kPi * r) / r : kPi * kPi;
            nodes.push_back({d, (right - left) * rule.w[i] * thickness * std::max(0.0, jacobian)});
        }
    }

    Rule mRule, mRimStrips, mRimPieces;
    std::vector<double> mSolidAngle;
};

class CubeCross final : public ImageProjection {
public:
    CubeCross(int w, int h)
        : ImageProjection(w, h)
        , mSize(w > h ? w / 4 : w / 3)
        , mRule(ruleFor(2.0 / mSize))
        , mFaces(w > h ? horizontalFaces() : verticalFaces())
    {
        mFaceOfCell.fill(-1);
        for (int f = 0; f < 6; ++f) mFaceOfCell[cellIndex(mFaces[f].column, mFaces[f].row)] = f;
        for (int y = 0; y < mSize; ++y)
            for (int x = 0; x < mSize; ++x) mSolidAngle.push_back(texelSolidAngle(x, y));
    }

    Texel texelAt(const Vec3d& d) const override
    {
        const Face& face = mFaces[faceOf(d)];
        const double depth = std::max(d.dot(face.n), 1e-300);
        const double a = d.dot(face.right) / depth, b = d.dot(face.up) / depth;
        return {face.column * mSize + clampIndex(0.5 * (1 + a) * mSize, mSize),
            face.row * mSize + clampIndex(0.5 * (1 - b) * mSize, mSize)};
    }

    bool pointIn(Texel texel, double s, double t, Vec3d& d) const override
    {
        const Face* face = faceAt(texel);
        if (!face) return false;
        const double a = faceX(texel.x % mSize + s), b = -faceX(texel.y % mSize + t);
        d = (face->n + face->right * a + face->up * b) / std::sqrt(1 + a * a + b * b);
        return true;
    }

    double pointDensity(Texel, const Vec3d& d) const override
    {
        // dω/dadb = cos³ of the angle to the face's normal; a texel is (2/size)² of dadb.
        const double c = std::max({std::abs(d.x), std::abs(d.y), std::abs(d.z)});
        return 0.25 * mSize * mSize / (c * c * c);
    }

    double solidAngle(Texel texel) const override
    {
        if (!faceAt(texel)) return 0.0;
        return mSolidAngle[static_cast<std::size_t>(texel.y % mSize) * mSize + texel.x % mSize];
    }

    void quadrature(Texel texel, std::vector<SphereNode>& nodes) const override
    {
        nodes.clear();
        if (!faceAt(texel)) return;
        const double area = 4.0 / mSize / mSize;
        for (std::size_t j = 0; j < mRule.x.size(); ++j) {
            for (std::size_t i = 0; i < mRule.x.size(); ++i) {
                Vec3d d(0);
                pointIn(texel, mRule.x[i], mRule.x[j], d);
                const double c = std::max({std::abs(d.x), std::abs(d.y), std::abs(d.z)});
                nodes.push_back({d, area * c * c * c * mRule.w[i] * mRule.w[j]});
            }
        }
    }

private:
    struct Face {
        int column, row;
        Vec3d n, right, up;
    };
    using Faces = std::array<Face, 6>;

    // Faces in the sequence +X, −X, +Y, −Y, +Z, −Z that faceOf() relies on.
    static Faces horizontalFaces()
    {
        const Vec3d X(1, 0, 0), Y(0, 1, 0), Z(0, 0, 1);
        return {{{2, 1, X, Z, Y}, {0, 1, -X, -Z, Y}, {1, 0, Y, X, Z}, {1, 2, -Y, X, -Z},
            {3, 1, Z, -X, Y}, {1, 1, -Z, X, Y}}};
    }

    static Faces verticalFaces()
    {
        Faces faces = horizontalFaces();
        faces[4] = {1, 3, Vec3d(0, 0, 1), Vec3d(1, 0, 0), Vec3d(0, -1, 0)};
        return faces;
    }

    static int faceOf(const Vec3d& d)
    {
        const double x = std::abs(d.x), y = std::abs(d.y), z = std::abs(d.z);
        if (x >= y && x >= z) return d.x >= 0 ? 0 : 1;
        if (y >= z) return d.y >= 0 ? 2 : 3;
        return d.z >= 0 ? 4 : 5;
    }

    static int cellIndex(int column, int row) { return row * 4 + column; }

    const Face* faceAt(Texel texel) const
    {
        const int f = mFaceOfCell[cellIndex(texel.x / mSize, texel.y / mSize)];
        return f < 0 ? nullptr : &mFaces[f];
    }

    double faceX(double pixel) const { return 2 * pixel / mSize - 1; }

    double texelSolidAngle(int x, int y) const
    {
        const auto corner
            = [](double a, double b) { return std::atan2(a * b, std::sqrt(1 + a * a + b * b)); };
        const double a0 = faceX(x), a1 = faceX(x + 1), b0 = faceX(y), b1 = faceX(y + 1);
        return (corner(a1, b1) - corner(a0, b1)) - (corner(a1, b0) - corner(a0, b0));
    }

    int mSize; // of a face, in texels
    Rule mRule;
    Faces mFaces;
    std::array<int, 16> mFaceOfCell;
    std::vector<double> mSolidAngle; // of the texels of a face
};

bool isCross(long long w, long long h)
{
    return (w * 4 == h * 3 && w % 3 == 0) || (w * 3 == h * 4 && w % 4 == 0);
}

} // namespace

EnvironmentProjection resolveProjection(
    EnvironmentProjection asked, int width, int height, const std::string& what)
{
    const auto fail = [&](const std::string& rest) {
        throw Error(ErrorCode::Input,
            what + " is " + std::to_string(width) + " x " + std::to_string(height) + " pixels, "
                + rest + ".");
    };
    if (width <= 0 || height <= 0) fail("which is no picture; use one with pixels");
    switch (asked) {
    case EnvironmentProjection::Auto:
        if (width == 2LL * height) return EnvironmentProjection::LatLong;
        if (width == height) return EnvironmentProjection::AngularMap;
        if (isCross(width, height)) return EnvironmentProjection::CubeCross;
        fail("which fits no environment; known aspects are 2:1 (lat-long), 1:1 (angular map), "
             "3:4 and 4:3 (cube cross)");
        break;
    case EnvironmentProjection::AngularMap:
        if (width != height) fail("but an angular map is square (1:1)");
        break;
    case EnvironmentProjection::CubeCross:
        if (!isCross(width, height)) fail("but a cube cross is 3:4 or 4:3 with square faces");
        break;
    case EnvironmentProjection::LatLong:
        break;
    }
    return asked;
}

std::unique_ptr<const ImageProjection> makeProjection(
    EnvironmentProjection projection, int width, int height)
{
    if (projection == EnvironmentProjection::AngularMap) return std::make_unique<AngularMap>(width);
    if (projection == EnvironmentProjection::CubeCross)
        return std::make_unique<CubeCross>(width, height);
    return std::make_unique<LatLong>(width, height);
}

} // namespace lumivdb::detail
