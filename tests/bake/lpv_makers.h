// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <lumivdb/bake/lpv.h>

#include <cmath>
#include <map>
#include <tuple>

namespace lumivdb::test {

constexpr double kPi = 3.14159265358979323846;
constexpr double kY0 = 0.28209479177387814347, kY1 = 0.48860251190291992159;

/// Fronts cell by cell, [Y_00, y, z, x] with positive signs, by light's way: the plainest form of
/// the scheme, in double precision.
struct PlainLpv {
    struct Key {
        int x, y, z;
        bool operator<(const Key& o) const { return std::tie(x, y, z) < std::tie(o.x, o.y, o.z); }
    };
    using Cell = std::array<double, 4>;
    std::map<Key, Cell> front;
    bool clamp = false;

    static Cell basis(const Vec3d& w) { return {kY0, kY1 * w.y, kY1 * w.z, kY1 * w.x}; }

    void step()
    {
        const double omegaFront = 4 * std::atan(std::sqrt(11.0) / 33);
        const double omegaSide = 2 * std::atan(3 / std::sqrt(11.0)) - kPi / 3;
        std::map<Key, Cell> next;
        for (const auto& [at, cell] : front) {
            for (int link = 0; link < 6; ++link) {
                const Vec3d d = axis(link);
                Cell& to = next[{at.x + int(d.x), at.y + int(d.y), at.z + int(d.z)}];
                for (int face = 0; face < 6; ++face) {
                    const Vec3d f = axis(face);
                    if (f == -d) continue;
                    const Vec3d w = f == d ? d : (d + 0.5 * f).normalized();
                    double I = 0;
                    for (std::size_t k = 0; k < 4; ++k) I += cell[k] * basis(w)[k];
                    if (clamp) I = std::max(0.0, I);
                    const double flux = (f == d ? omegaFront : omegaSide) * I;
                    const Cell lobe = {std::sqrt(kPi) / 2, std::sqrt(kPi / 3) * f.y,
                        std::sqrt(kPi / 3) * f.z, std::sqrt(kPi / 3) * f.x};
                    for (std::size_t k = 0; k < 4; ++k) to[k] += flux / kPi * lobe[k];
                }
            }
        }
        front = next;
    }

    static Vec3d axis(int i)
    {
        Vec3d d(0.0);
        d[i / 2] = i % 2 ? -1 : 1;
        return d;
    }
};

/// The front of one channel in that form.
inline PlainLpv::Cell frontOf(const LightPropagationVolume& lpv, const Coord& cell, int channel = 0)
{
    Color I[4];
    lpv.frontIntensity(cell, I);
    const auto value = [&](int i) { return static_cast<double>(I[i][channel]); };
    return {value(0), -value(1), value(2), -value(3)};
}

/// White, isotropic, Y_00 coefficient 1, in the cell at the origin.
inline void injectIsotropic(LightPropagationVolume& lpv, float c00 = 1, const Vec3d& p = Vec3d(0.0))
{
    const Color I[4] = {Color(c00), Color(0.0f), Color(0.0f), Color(0.0f)};
    lpv.injectSource(p, I);
}

inline Surfel surfelAt(const Vec3d& p, const Vec3f& n, const Color& flux, float area = 1)
{
    Surfel s;
    s.position = p;
    s.normal = n;
    s.flux = flux;
    s.area = area;
    return s;
}

inline LpvOptions plainOptions(LpvScheme scheme, double spacing = 1)
{
    LpvOptions o;
    o.spacing = spacing;
    o.scheme = scheme;
    o.occlusion = LpvOcclusion::Off;
    return o;
}

} // namespace lumivdb::test
