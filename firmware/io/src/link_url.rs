//! Where the vehicle's MAVLink is: connection URLs in MAVSDK's notation.

use std::net::{Ipv4Addr, SocketAddr, ToSocketAddrs};
use std::str::FromStr;

/// A parsed link URL.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LinkUrl {
    /// `udpin://address:port`: listens there and answers whoever speaks first.
    UdpIn(SocketAddr),
    /// `udpout://host:port`: sends there.
    UdpOut(SocketAddr),
    /// `tcpin://address:port`: listens there and serves who connects first.
    TcpIn(SocketAddr),
    /// `tcpout://host:port`: connects there.
    TcpOut(SocketAddr),
    /// `serial:///dev/device:baud`.
    Serial {
        /// The device.
        device: String,
        /// Bits per second.
        baud: u32,
    },
    /// One of a host that is not known yet: it is looked up at the next start, and not at all in flight.
    Unknown(String),
}

/// A URL that is not understood.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "link `{url}`: {reason}; use udpin://ADDRESS:PORT or tcpin://ADDRESS:PORT to listen, udpout://HOST:PORT or \
     tcpout://HOST:PORT to call, or serial:///dev/DEVICE:BAUD"
)]
pub struct LinkUrlError {
    url: String,
    reason: String,
}

impl LinkUrl {
    /// Whether only this machine can be at the other end: a loopback address.
    pub fn is_on_this_machine(&self) -> bool {
        match self {
            Self::UdpIn(a) | Self::UdpOut(a) | Self::TcpIn(a) | Self::TcpOut(a) => a.ip().to_canonical().is_loopback(),
            Self::Serial { .. } | Self::Unknown(_) => false,
        }
    }
}

impl FromStr for LinkUrl {
    type Err = LinkUrlError;

    fn from_str(url: &str) -> Result<Self, LinkUrlError> {
        let error = |reason: &str| LinkUrlError {
            url: url.to_owned(),
            reason: reason.to_owned(),
        };
        let Some((scheme, address)) = url.split_once("://") else {
            return Err(error("no scheme"));
        };
        let unknown = || Self::Unknown(url.to_owned());
        let parsed = match scheme {
            "udpin" => listen(address).map(Self::UdpIn),
            "tcpin" => listen(address).map(Self::TcpIn),
            "udpout" => call(address).map(|peer| peer.map_or_else(unknown, Self::UdpOut)),
            "tcpout" => call(address).map(|peer| peer.map_or_else(unknown, Self::TcpOut)),
            "serial" => serial(address),
            _ => Err("this scheme is not supported"),
        };
        parsed.map_err(error)
    }
}

fn host_and_port(address: &str) -> Result<(&str, u16), &'static str> {
    let (host, port) = address.rsplit_once(':').ok_or("no port")?;
    match port.parse() {
        Ok(port) if port > 0 => Ok((host, port)),
        _ => Err("the port must be 1 to 65535"),
    }
}

fn of_one(address: SocketAddr) -> Result<SocketAddr, &'static str> {
    let ip = address.ip().to_canonical();
    match ip.is_multicast() || ip == Ipv4Addr::BROADCAST {
        true => Err("one address is needed: broadcast and multicast are not supported"),
        false => Ok(address),
    }
}

fn listen(address: &str) -> Result<SocketAddr, &'static str> {
    let (host, port) = host_and_port(address)?;
    // MAVSDK's `udpin://:14540` means all addresses.
    let host = if host.is_empty() { "0.0.0.0" } else { host };
    format!("{host}:{port}")
        .parse()
        .map_err(|_| "the address to listen on must be an IP address")
        .and_then(of_one)
}

/// `None` for a host that is not known.
fn call(address: &str) -> Result<Option<SocketAddr>, &'static str> {
    let (host, port) = host_and_port(address)?;
    if host.is_empty() {
        return Err("the host is not known");
    }
    let found = (host.trim_matches(['[', ']']), port).to_socket_addrs().ok();
    // As MAVSDK: `localhost` is 127.0.0.1, whatever stands first.
    match found.and_then(|found| found.min_by_key(SocketAddr::is_ipv6)) {
        Some(nobody) if nobody.ip().is_unspecified() => Err("the host must be one that can be called"),
        peer => peer.map(of_one).transpose(),
    }
}

fn serial(address: &str) -> Result<LinkUrl, &'static str> {
    let (device, baud) = address.rsplit_once(':').ok_or("no baud rate")?;
    if !device.starts_with('/') || device.contains('\0') {
        return Err("the device must be a full path");
    }
    match baud.parse() {
        Ok(baud) if (300..=20_000_000).contains(&baud) => Ok(LinkUrl::Serial {
            device: device.to_owned(),
            baud,
        }),
        _ => Err("the baud rate must be 300 to 20000000"),
    }
}

impl std::fmt::Display for LinkUrl {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::UdpIn(address) => write!(f, "udpin://{address}"),
            Self::UdpOut(address) => write!(f, "udpout://{address}"),
            Self::TcpIn(address) => write!(f, "tcpin://{address}"),
            Self::TcpOut(address) => write!(f, "tcpout://{address}"),
            Self::Serial { device, baud } => write!(f, "serial://{device}:{baud}"),
            Self::Unknown(url) => write!(f, "{url}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn urls_mean_what_they_mean_to_mavsdk() {
        let all = LinkUrl::UdpIn("0.0.0.0:14030".parse().unwrap());
        assert_eq!("udpin://0.0.0.0:14030".parse().as_ref(), Ok(&all));
        assert_eq!("udpin://:14030".parse(), Ok(all));
        let there = "127.0.0.1:14550".parse().unwrap();
        assert_eq!("udpout://127.0.0.1:14550".parse(), Ok(LinkUrl::UdpOut(there)));
        assert_eq!("tcpout://127.0.0.1:14550".parse(), Ok(LinkUrl::TcpOut(there)));
        let v6 = LinkUrl::UdpIn("[::1]:14030".parse().unwrap());
        assert_eq!("udpin://[::1]:14030".parse(), Ok(v6));
        let serial = LinkUrl::Serial {
            device: "/dev/ttyUSB0".to_owned(),
            baud: 57_600,
        };
        assert_eq!("serial:///dev/ttyUSB0:57600".parse(), Ok(serial));
    }

    #[test]
    fn a_url_that_was_written_is_read_back() {
        for url in [
            "udpin://0.0.0.0:14030",
            "udpin://[::1]:14030",
            "udpout://10.0.0.2:14550",
            "tcpin://127.0.0.1:5760",
            "tcpout://127.0.0.1:5760",
            "serial:///dev/serial/by-id/usb-a:b-if00:921600",
            "udpout://no..host:14550",
        ] {
            let parsed: LinkUrl = url.parse().unwrap();
            assert_eq!(parsed.to_string(), url);
        }
    }

    #[test]
    fn what_is_not_understood_is_reported_with_what_would_be() {
        for (url, reason) in [
            ("14030", "no scheme"),
            ("udpin://0.0.0.0", "port"),
            ("udpin://0.0.0.0:0", "1 to 65535"),
            ("tcpin://0.0.0.0:99999", "1 to 65535"),
            ("udpin://vehicle:14030", "IP address"),
            ("udpout://:14030", "not known"),
            ("udpout://255.255.255.255:14030", "one address"),
            ("udpin://239.255.1.1:14030", "one address"),
            ("tcpout://0.0.0.0:14030", "can be called"),
            ("serial:///dev/ttyUSB0", "baud rate"),
            ("serial:///dev/ttyUSB0:fast", "300 to"),
            ("serial://ttyUSB0:57600", "full path"),
            ("can://0:1", "not supported"),
        ] {
            let error = url.parse::<LinkUrl>().unwrap_err().to_string();
            assert!(error.contains(reason) && error.contains("udpout://"), "{url}: {error}");
        }
    }
}
