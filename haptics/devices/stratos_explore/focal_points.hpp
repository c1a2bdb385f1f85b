// SPDX-License-Identifier: GPL-3.0-or-later
// The focal points that the array server sends; haptics/protocol/datagram.py describes the format.
// Here the fourth number of each point is an intensity from 0 to 1.

#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <optional>
#include <vector>

namespace tactile_clay {

struct FocalPoint {
    float x, y, z;     // meters from the center of the array, z out of it
    float intensity;   // 0 to 1
};

struct FociMessage {
    std::uint32_t session = 0;
    std::uint64_t sequence = 0;
    bool modulated = true;
    std::vector<FocalPoint> points;
};

inline std::uint32_t checksum(const unsigned char *data, std::size_t size) {
    std::uint32_t crc = 0xFFFFFFFFu;
    for (std::size_t i = 0; i < size; ++i) {
        crc ^= data[i];
        for (int bit = 0; bit < 8; ++bit) crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
    }
    return ~crc;
}

// Reads little-endian numbers on machines with any byte order.
template <typename Number>
Number read_number(const unsigned char *data) {
    std::uint64_t bits = 0;
    for (std::size_t i = 0; i < sizeof(Number); ++i) bits |= std::uint64_t(data[i]) << (8 * i);
    if constexpr (sizeof(Number) == 4) {
        const auto small = static_cast<std::uint32_t>(bits);
        Number number;
        std::memcpy(&number, &small, 4);
        return number;
    } else {
        Number number;
        std::memcpy(&number, &bits, sizeof(Number));
        return number;
    }
}

// Returns nothing unless the datagram is valid and its numbers can be emitted.
inline std::optional<FociMessage> read_focal_points(const unsigned char *data, std::size_t size,
                                                    std::size_t limit) {
    constexpr std::size_t head = 32, point = 16, check = 4;
    if (size < head + check || std::memcmp(data, "TCFP", 4) != 0) return std::nullopt;
    if (data[4] != 1 || data[5] != 1 || data[6] > 1 || data[7] != 0) return std::nullopt;
    const auto count = read_number<std::uint32_t>(data + 12);
    if (count > limit || size != head + count * point + check) return std::nullopt;
    if (read_number<std::uint32_t>(data + size - check) != checksum(data, size - check))
        return std::nullopt;
    FociMessage read;
    read.session = read_number<std::uint32_t>(data + 8);
    read.sequence = read_number<std::uint64_t>(data + 16);
    read.modulated = data[6] == 0;
    for (std::size_t i = 0; i < count; ++i) {
        const unsigned char *row = data + head + i * point;
        const FocalPoint one{read_number<float>(row), read_number<float>(row + 4),
                             read_number<float>(row + 8), read_number<float>(row + 12)};
        if (!std::isfinite(one.x) || !std::isfinite(one.y) || !std::isfinite(one.z) ||
            !(one.intensity >= 0.0f && one.intensity <= 1.0f))
            return std::nullopt;
        read.points.push_back(one);
    }
    return read;
}

}  // namespace tactile_clay
