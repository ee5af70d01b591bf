#!/bin/bash
# SPDX-License-Identifier: Apache-2.0
# Installs the Debian 12 packages that LumiVDB is built from, those that are missing; says and does
# nothing when all are there. More groups by name: tests (Blender), format (clang-format).
#   ./install_packages.sh [tests] [format]
set -euo pipefail

# zlib1g-dev and openimageio-tools: what OpenVDB's and OpenImageIO's CMake files ask for.
# fonts-dejavu-core: the numbers in pictures. gnuplot-nox: bench --plot.
packages=(g++ cmake ninja-build ccache pkg-config
    libopenvdb-dev libboost-dev libboost-iostreams-dev libblosc-dev zlib1g-dev libimath-dev libtbb-dev
    libhwy-dev
    libembree-dev libopenimageio-dev openimageio-tools libtinygltf-dev libassimp-dev
    libcli11-dev nlohmann-json3-dev catch2 python3 python3-openvdb python3-numpy fonts-dejavu-core
    gnuplot-nox)
for group in "$@"; do
    case "$group" in
        tests) packages+=(blender) ;;
        format) packages+=(clang-format) ;;
        *) echo "install_packages.sh: unknown group '$group'; there are: tests, format" >&2; exit 2 ;;
    esac
done

if ! command -v apt-get >/dev/null; then
    echo "install_packages.sh: this is not a Debian system; install what corresponds to:" \
        "${packages[*]}" >&2
    exit 3
fi
missing=()
for package in "${packages[@]}"; do
    status=$(dpkg-query -W -f '${db:Status-Status}' "$package" 2>/dev/null || true)
    [ "$status" = installed ] || missing+=("$package")
done
[ ${#missing[@]} -gt 0 ] || exit 0

as_root=()
if [ "$(id -u)" -ne 0 ]; then
    if ! command -v sudo >/dev/null; then
        echo "install_packages.sh: run as root: apt-get install ${missing[*]}" >&2
        exit 3
    fi
    as_root=(sudo)
fi
echo "Installing ${missing[*]}"
log=$(mktemp)
trap 'rm -f "$log"' EXIT
install() {
    "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends \
        -o DPkg::Lock::Timeout=300 "${missing[@]}" >"$log" 2>&1
}
# The package lists may be old or absent: then fetch them and try once more.
if ! install; then
    if ! { "${as_root[@]}" apt-get update >"$log" 2>&1 && install; }; then
        cat "$log" >&2
        exit 3
    fi
fi
