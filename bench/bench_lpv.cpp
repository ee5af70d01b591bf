// SPDX-License-Identifier: Apache-2.0
/// Light propagation on leaves against plain arrays and OpenVDB's accessors, the same light:
///   lumivdb_bench_lpv [largest width, default 128]
///
/// Times of one thread are its processor time, those of two are wall time; each is the least of
/// some runs, and contenders take turns.

#include "lpv_contenders.h"

#include <lumivdb/bake/lpv.h>
#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>

using namespace lumivdb;

namespace {

constexpr double kPi = 3.14159265358979323846;

double threadSeconds()
{
    timespec t{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

double wallSeconds()
{
    const auto now = std::chrono::steady_clock::now().time_since_epoch();
    return std::chrono::duration<double>(now).count();
}

template <class Work> double least(int runs, double (*clock)(), Work work)
{
    double best = 1e300;
    for (int i = 0; i < runs; ++i) {
        const double start = clock();
        work();
        best = std::min(best, clock() - start);
    }
    return best;
}

LpvOptions optionsOf(int threads)
{
    LpvOptions options;
    options.spacing = 1;
    options.occlusion = LpvOcclusion::Off;
    options.threads = threads;
    return options;
}

/// Surfels whose light enters the cells of a box, one each.
std::vector<Surfel> lightIn(const LatticeBox& box)
{
    std::vector<Surfel> surfels;
    CounterRng rng(1);
    for (int x = box.lower.x; x < box.upper.x; ++x) {
        for (int y = box.lower.y; y < box.upper.y; ++y) {
            for (int z = box.lower.z; z < box.upper.z; ++z) {
                Surfel s;
                s.normal = Vec3f(rng.next() - 0.5f, rng.next() - 0.5f, rng.next() - 0.5f);
                s.normal.normalize();
                s.position = Vec3d(x, y, z) - 0.5 * Vec3d(s.normal);
                s.flux = Color(rng.next(), rng.next(), 1);
                surfels.push_back(s);
            }
        }
    }
    return surfels;
}

template <class Contender> void addAll(Contender& contender, const std::vector<Surfel>& surfels)
{
    for (const Surfel& s : surfels) {
        const Vec3d p = s.position + 0.5 * Vec3d(s.normal);
        lpv_bench::State state;
        const Vec3d flux(s.flux);
        state[0] = Color(flux / (4 * kPi));
        for (int k = 0; k < 3; ++k)
            state[static_cast<std::size_t>(k) + 1]
                = Color(flux * static_cast<double>(s.normal[k]) / (2 * kPi));
        contender.add({static_cast<int>(std::lround(p.x)), static_cast<int>(std::lround(p.y)),
                          static_cast<int>(std::lround(p.z))},
            state);
    }
}

/// Largest difference of radiance's constant band to ours over its largest value.
template <class Contender>
double difference(const LightPropagationVolume& lpv, const Contender& other, int n)
{
    double worst = 0, largest = 0;
    for (int x = 0; x < n; x += 3) {
        for (int y = 0; y < n; y += 3) {
            for (int z = 0; z < n; ++z) {
                Color L[4];
                lpv.radiance(Vec3d(x, y, z), L);
                // 2/3 A / Y_0
                const double a = static_cast<double>(L[0].y);
                const double b = static_cast<double>(other.sum({x, y, z})[0].y) * 2.3632718012;
                worst = std::max(worst, std::abs(a - b));
                largest = std::max(largest, a);
            }
        }
    }
    return worst / largest;
}

void checkSame(double difference, const char* what)
{
    if (difference < 2e-6) return;
    std::printf("  %s differs by %.1e: not the same light\n", what, difference);
    std::exit(1);
}

void print(const char* what, double seconds, double cells, double reference)
{
    std::printf("  %-28s %9.3f ms/iteration %8.2f ns/cell %6.2f of the array\n", what,
        1e3 * seconds, 1e9 * seconds / cells, seconds / reference);
}

void benchBox(int n, const LatticeBox& lit, int iterations, const char* name)
{
    const LatticeBox box{{0, 0, 0}, {n, n, n}};
    const std::vector<Surfel> surfels = lightIn(lit);
    const double cells = static_cast<double>(n) * n * n;
    LightPropagationVolume one(optionsOf(1), box), two(optionsOf(2), box);
    double active = 0, ours = 1e300, oursTwo = 1e300, dense = 1e300;
    lpv_bench::DenseLpv last(n);
    for (int run = 0; run < 3; ++run) {
        lpv_bench::DenseLpv array(n);
        addAll(array, surfels);
        dense = std::min(dense, least(1, threadSeconds, [&] {
            for (int i = 0; i < iterations; ++i) array.step();
        }));
        for (LightPropagationVolume* lpv : {&one, &two}) {
            lpv->clearLight();
            lpv->inject(surfels);
            if (run == 0) { // also makes the blocks
                active = 0;
                for (int i = 0; i < iterations; ++i) {
                    lpv->step();
                    active += static_cast<double>(lpv->activeCells()) / iterations;
                }
                continue;
            }
            double& best = lpv == &one ? ours : oursTwo;
            best = std::min(best, least(1, lpv == &one ? threadSeconds : wallSeconds, [&] {
                lpv->propagate({iterations, 0});
            }));
        }
        last = array;
    }
    checkSame(difference(one, last, n), "the array");
    dense /= iterations;
    std::printf("%d^3 %s, %d iterations, %.0f%% of the cells in lit leaves\n", n, name, iterations,
        100 * active / cells);
    print("plain array", dense, cells, dense);
    print("leaves, 1 thread", ours / iterations, active, dense);
    print("leaves, 2 threads (wall)", oursTwo / iterations, active, dense);
    if (n > 64 || !(lit == box)) return;
    lpv_bench::AccessorLpv grids(n);
    addAll(grids, surfels);
    const double accessors = least(1, threadSeconds, [&] {
        for (int i = 0; i < iterations; ++i) grids.step();
    });
    checkSame(difference(one, grids, n), "the grids");
    print("12 grids, accessors", accessors / iterations, cells, dense);
}

/// A light of 128² surfels that moves over a floor.
void benchMovingLight()
{
    for (const int threads : {1, 2}) {
        LpvOptions options = optionsOf(threads);
        options.spacing = 0.25;
        options.occlusion = LpvOcclusion::On;
        LightPropagationCascades lpv(options, {}, Vec3d(0.0));
        std::vector<Blocker> floor;
        for (int i = 0; i < 256 * 256; ++i) {
            Blocker b;
            b.position = Vec3d(i % 256 - 127.5, -8, i / 256 - 127.5) * 0.125;
            b.position.y = -1.1;
            b.normal = Vec3f(0, 1, 0);
            b.area = 0.125f * 0.125f;
            floor.push_back(b);
        }
        lpv.setGeometry(floor);
        double inject = 0, propagate = 0;
        const int updates = 20;
        for (int update = -updates; update < updates; ++update) {
            std::vector<Surfel> surfels(128 * 128);
            for (int i = 0; i < 128 * 128; ++i) {
                Surfel& s = surfels[static_cast<std::size_t>(i)];
                s.position = Vec3d(
                    (i % 128 - 64) * 0.02 + 0.1 * (update % updates), -1.1, (i / 128 - 64) * 0.02);
                s.normal = Vec3f(0, 1, 0);
                s.flux = Color(1e-3f);
            }
            const double start = wallSeconds();
            lpv.clearLight();
            lpv.inject(surfels);
            const double middle = wallSeconds();
            lpv.propagate({32, 0});
            if (update < 0) continue; // the first round makes the blocks
            inject += middle - start;
            propagate += wallSeconds() - middle;
        }
        std::printf("32^3 x 3 cascades, occlusion, 32 iterations, %d thread%s (wall): inject 16384 "
                    "surfels %.2f ms, propagate %.2f ms\n",
            threads, threads > 1 ? "s" : "", 1e3 * inject / updates, 1e3 * propagate / updates);
    }
}

} // namespace

int main(int argc, char** argv)
{
    try {
        const int largest = argc > 1 ? std::atoi(argv[1]) : 128;
        for (int n = 32; n <= largest; n *= 2) {
            const int iterations = n == 32 ? 64 : n == 64 ? 16 : 8;
            benchBox(n, {{0, 0, 0}, {n, n, n}}, iterations, "all lit");
            const int m = n / 2;
            benchBox(n, {{m, m, m}, {m + 2, m + 2, m + 2}}, n / 2, "front");
        }
        benchMovingLight();
        return 0;
    } catch (const Error& e) {
        std::fprintf(stderr, "%s\n", e.what());
        return static_cast<int>(e.code());
    }
}
