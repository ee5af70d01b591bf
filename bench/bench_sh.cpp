// SPDX-License-Identifier: Apache-2.0
/// The kernels of spherical harmonics, one thread, times beside errors:
///   lumivdb_bench_sh [texels along a cube map's face]
///
/// Projection stands against the usual loop: per texel a direction, its basis in single precision,
/// an approximate solid angle, and three sums per coefficient, normalised to 4π at the end.

#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>
#include <lumivdb/core/sh.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>

using namespace lumivdb;

namespace {

constexpr double kPi = 3.14159265358979323846;
using Faces = std::array<const Color*, 6>;

/// Best of some runs, in seconds.
template <class Work> double secondsOf(int runs, Work work)
{
    double best = 1e300;
    for (int i = 0; i < runs; ++i) {
        const auto start = std::chrono::steady_clock::now();
        work();
        const std::chrono::duration<double> took = std::chrono::steady_clock::now() - start;
        best = std::min(best, took.count());
    }
    return best;
}

template <class T> Imath::Vec3<T> directionOf(int face, T u, T v)
{
    switch (face) {
    case 0:
        return {1, -v, -u};
    case 1:
        return {-1, -v, u};
    case 2:
        return {u, 1, v};
    case 3:
        return {u, -1, -v};
    case 4:
        return {u, -v, 1};
    default:
        return {-u, -v, -1};
    }
}

void plainLoop(int bands, int size, const Faces& faces, Color* out)
{
    const int count = coefficientCount(bands);
    std::fill_n(out, count, Color(0.0f));
    float total = 0.0f, basis[kMaxCoefficients];
    for (int f = 0; f < 6; ++f) {
        for (int y = 0; y < size; ++y) {
            for (int x = 0; x < size; ++x) {
                const float u = (2 * x + 1.0f) / size - 1, v = (2 * y + 1.0f) / size - 1;
                const float r2 = 1 + u * u + v * v, r = std::sqrt(r2);
                const float solidAngle = 4.0f / (r2 * r);
                total += solidAngle;
                evalShBasis(bands, directionOf(f, u, v) / r, basis);
                const Color L = faces[f][y * size + x] * solidAngle;
                for (int i = 0; i < count; ++i) out[i] += L * basis[i];
            }
        }
    }
    for (int i = 0; i < count; ++i) out[i] *= static_cast<float>(4 * kPi / total);
}

/// Σ L Y(centre) ΔΩ with exact solid angles, summed in extended precision.
std::vector<Vec3d> exactSum(int bands, int size, const Faces& faces)
{
    const int count = coefficientCount(bands);
    const auto corner = [](long double a, long double b) {
        return std::atan2(a * b, std::sqrt(1 + a * a + b * b));
    };
    std::vector<std::array<long double, 3>> sums(count, {0, 0, 0});
    double basis[kMaxCoefficients];
    for (int f = 0; f < 6; ++f) {
        for (int y = 0; y < size; ++y) {
            for (int x = 0; x < size; ++x) {
                const long double u0 = 2.0L * x / size - 1, u1 = 2.0L * (x + 1) / size - 1;
                const long double v0 = 2.0L * y / size - 1, v1 = 2.0L * (y + 1) / size - 1;
                const long double solidAngle
                    = corner(u1, v1) - corner(u0, v1) - corner(u1, v0) + corner(u0, v0);
                const double u = (2 * x + 1.0) / size - 1, v = (2 * y + 1.0) / size - 1;
                evalShBasis(bands, directionOf(f, u, v).normalized(), basis);
                const Color& L = faces[f][y * size + x];
                for (int i = 0; i < count; ++i)
                    for (int c = 0; c < 3; ++c) sums[i][c] += L[c] * solidAngle * basis[i];
            }
        }
    }
    std::vector<Vec3d> result;
    for (const auto& s : sums)
        result.emplace_back(
            static_cast<double>(s[0]), static_cast<double>(s[1]), static_cast<double>(s[2]));
    return result;
}

double relativeError(const Color* c, const std::vector<Vec3d>& reference)
{
    double difference = 0, norm = 0;
    for (std::size_t i = 0; i < reference.size(); ++i) {
        difference += (Vec3d(c[i]) - reference[i]).length2();
        norm += reference[i].length2();
    }
    return std::sqrt(difference / norm);
}

void benchProjection(int size)
{
    CounterRng rng(1);
    std::vector<Color> texels(6 * static_cast<std::size_t>(size) * size);
    for (Color& c : texels)
        for (int channel = 0; channel < 3; ++channel) c[channel] = std::exp(4 * rng.next() - 2);
    Faces faces;
    for (int f = 0; f < 6; ++f) faces[f] = texels.data() + f * texels.size() / 6;
    std::printf(
        "Projection of %d x %d x 6 RGB texels (error: relative, of all coefficients)\n"
        "bands   plain loop        error   centres       error  faster   areas     faster\n",
        size, size);
    for (int bands = 1; bands <= kMaxBands; ++bands) {
        Color out[kMaxCoefficients];
        const std::vector<Vec3d> reference = exactSum(bands, size, faces);
        const double plain = secondsOf(5, [&] { plainLoop(bands, size, faces, out); });
        const double plainError = relativeError(out, reference);
        const double areas = secondsOf(15, [&] { projectCubeMap(bands, size, faces, out); });
        const double centres
            = secondsOf(15, [&] { projectCubeMap(bands, size, faces, out, CubeTexels::Centres); });
        std::printf("%5d %9.3f ms %12.1e %6.3f ms %11.1e %6.1fx %6.3f ms %6.1fx\n", bands,
            plain * 1e3, plainError, centres * 1e3, relativeError(out, reference), plain / centres,
            areas * 1e3, plain / areas);
    }
}

Vec3d randomDirection(CounterRng& rng)
{
    const double z = 2 * rng.nextDouble() - 1, phi = 2 * kPi * rng.nextDouble();
    const double r = std::sqrt(1 - z * z);
    return Vec3d(r * std::cos(phi), r * std::sin(phi), z);
}

void benchBasis()
{
    constexpr int kDirections = 1024;
    CounterRng rng(2);
    std::vector<Vec3f> directions;
    std::vector<float> axes[3], values(kDirections * kMaxCoefficients);
    for (int i = 0; i < kDirections; ++i) {
        directions.emplace_back(randomDirection(rng));
        for (int a = 0; a < 3; ++a) axes[a].push_back(directions.back()[a]);
    }
    std::printf("\nBasis at a direction, ns\nbands  single   batch\n");
    volatile float sink = 0;
    for (int bands = 1; bands <= kMaxBands; ++bands) {
        float y[kMaxCoefficients];
        const double single = secondsOf(200, [&] {
            float sum = 0;
            for (const Vec3f& d : directions) {
                evalShBasis(bands, d, y);
                sum += y[coefficientCount(bands) - 1];
            }
            sink = sum;
        });
        const double batch = secondsOf(200, [&] {
            evalShBasisBatch(
                bands, kDirections, axes[0].data(), axes[1].data(), axes[2].data(), values.data());
        });
        std::printf(
            "%5d %7.2f %7.2f\n", bands, single / kDirections * 1e9, batch / kDirections * 1e9);
    }
    static_cast<void>(sink);
}

Mat3d randomRotation(CounterRng& rng)
{
    const Vec3d x = randomDirection(rng);
    const Vec3d y = x.cross(randomDirection(rng)).normalized(), z = x.cross(y);
    return Mat3d(x.x, x.y, x.z, y.x, y.y, y.z, z.x, z.y, z.z);
}

void benchRotation()
{
    CounterRng rng(3);
    std::vector<Mat3d> matrices;
    for (int i = 0; i < 256; ++i) matrices.push_back(randomRotation(rng));
    std::vector<Color> L(kMaxCoefficients), out(kMaxCoefficients);
    for (Color& c : L) c = Color(rng.next(), rng.next(), rng.next());
    std::printf("\nRotation of three channels, ns: once, with matrices that are there, with their\n"
                "making (difference of the first two, relative)\n"
                "bands    once   matrix  making  difference\n");
    const double n = static_cast<double>(matrices.size());
    for (int bands = 1; bands <= kMaxBands; ++bands) {
        std::vector<ShRotation> rotations;
        const double making = secondsOf(20, [&] {
            rotations.clear();
            for (const Mat3d& R : matrices) rotations.emplace_back(bands, R);
        });
        const double matrix = secondsOf(100, [&] {
            for (const ShRotation& r : rotations) r.apply(L.data(), out.data());
        });
        const double once = secondsOf(100, [&] {
            for (const Mat3d& R : matrices) rotateSh(bands, R, L.data(), out.data());
        });
        std::vector<Color> same(coefficientCount(bands));
        rotations.back().apply(L.data(), same.data());
        std::printf("%5d %7.1f %8.1f %7.0f %11.1e\n", bands, once / n * 1e9, matrix / n * 1e9,
            making / n * 1e9,
            relativeError(out.data(), std::vector<Vec3d>(same.begin(), same.end())));
    }
}

} // namespace

int main(int argc, char** argv)
{
    const int size = argc > 1 ? std::atoi(argv[1]) : 128;
    if (argc > 2 || size < 1 || size > 4096) {
        std::fprintf(stderr, "usage: %s [texels along a cube map's face, 1 to 4096]\n", argv[0]);
        return 2;
    }
    benchProjection(size);
    benchBasis();
    benchRotation();
    return 0;
}
