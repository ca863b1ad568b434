//! The CRC32 of MAVLink FTP, component metadata and parameters' digest: the polynomial of IEEE 802.3, but it begins with 0 and is not
//! inverted at the end. <https://mavlink.io/en/services/ftp.html>
#![expect(
    clippy::indexing_slicing,
    reason = "a table of 256 is read at a byte; the rest is const"
)]

const TABLE: [u32; 256] = {
    let mut table = [0; 256];
    let mut i = 0;
    while i < 256 {
        let mut crc = i as u32;
        let mut bit = 0;
        while bit < 8 {
            crc = if crc & 1 == 1 { crc >> 1 ^ 0xEDB8_8320 } else { crc >> 1 };
            bit += 1;
        }
        table[i] = crc;
        i += 1;
    }
    table
};

/// Of these bytes.
pub const fn crc32(bytes: &[u8]) -> u32 {
    crc32_on(0, bytes)
}

/// The same over what `crc` stands for and these bytes behind it.
pub const fn crc32_on(mut crc: u32, mut bytes: &[u8]) -> u32 {
    while let [first, rest @ ..] = bytes {
        crc = TABLE[(crc as u8 ^ *first) as usize] ^ (crc >> 8);
        bytes = rest;
    }
    crc
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_checksum_is_the_one_of_the_protocol() {
        // zlib: crc32(data, 0xFFFFFFFF) ^ 0xFFFFFFFF begins its register with 0.
        assert_eq!(crc32(b""), 0);
        assert_eq!(crc32(b"123456789"), 0x2DFD_2D88);
    }
}
