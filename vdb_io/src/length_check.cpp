// SPDX-License-Identifier: Apache-2.0
#include "length_check.h"

#include <stdexcept>
#include <string>

namespace lumivdb {

namespace {

class Scan {
public:
    Scan(std::istream& stream, std::uint64_t fileSize)
        : mStream(stream)
        , mBegin(stream.tellg())
        , mLeft(fileSize - static_cast<std::uint64_t>(mBegin))
    {
    }
    void rewind() { mStream.seekg(mBegin); }

    std::uint32_t number()
    {
        take(4);
        unsigned char b[4];
        mStream.read(reinterpret_cast<char*>(b), 4);
        return b[0] | b[1] << 8 | b[2] << 16 | static_cast<std::uint32_t>(b[3]) << 24;
    }
    std::string string()
    {
        const std::uint32_t size = number();
        take(size);
        std::string text(size, '\0');
        mStream.read(text.data(), size);
        return text;
    }
    void skip(std::uint32_t size)
    {
        take(size);
        mStream.ignore(size);
    }
    /// A count of things of which each takes a byte or more further on.
    void limit(std::uint64_t count) const
    {
        if (count > mLeft) throw std::runtime_error("impossible length");
    }

private:
    void take(std::uint64_t bytes)
    {
        limit(bytes);
        mLeft -= bytes;
    }

    std::istream& mStream;
    std::streampos mBegin;
    std::uint64_t mLeft;
};

} // namespace

void checkStrings(std::istream& stream, std::uint64_t fileSize, int count)
{
    Scan scan(stream, fileSize);
    for (int i = 0; i < count; ++i) scan.string();
    scan.rewind();
}

void checkMetadata(std::istream& stream, std::uint64_t fileSize)
{
    Scan scan(stream, fileSize);
    for (std::uint32_t left = scan.number(); left > 0; --left) {
        scan.string();
        const std::string type = scan.string();
        const std::uint32_t size = scan.number();
        if (type == "__delayedload" && size >= 8) {
            scan.limit(scan.number()); // leaves
            scan.limit(scan.number()); // compressed bytes
            scan.skip(size - 8);
        } else {
            scan.skip(size);
        }
    }
    scan.rewind();
}

void checkBufferCount(std::istream& stream)
{
    const std::streampos begin = stream.tellg();
    std::int32_t buffers = 0;
    stream.read(reinterpret_cast<char*>(&buffers), sizeof buffers);
    if (buffers != 1) throw std::runtime_error("impossible number of buffers");
    stream.seekg(begin);
}

} // namespace lumivdb
