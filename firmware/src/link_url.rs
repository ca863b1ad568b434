//! Where the vehicle's MAVLink is: connection URLs in MAVSDK's notation.

use std::net::{SocketAddr, ToSocketAddrs};
use std::str::FromStr;

/// A parsed link URL.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LinkUrl {
    /// `udpin://address:port`: listens there and answers whoever speaks first.
    UdpIn(SocketAddr),
    /// `udpout://host:port`: sends there.
    UdpOut(SocketAddr),
}

/// A URL that is not understood.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("link `{url}`: {reason}; use udpin://ADDRESS:PORT to listen or udpout://HOST:PORT to call")]
pub struct LinkUrlError {
    url: String,
    reason: String,
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
        let Some((host, port)) = address.rsplit_once(':') else {
            return Err(error("no port"));
        };
        let port: u16 = port.parse().map_err(|_| error("the port must be 1 to 65535"))?;
        if port == 0 {
            return Err(error("the port must be 1 to 65535"));
        }
        match scheme {
            // MAVSDK's `udpin://:14540` means all addresses.
            "udpin" => {
                let host = if host.is_empty() { "0.0.0.0" } else { host };
                let address = format!("{host}:{port}");
                address
                    .parse()
                    .map(Self::UdpIn)
                    .map_err(|_| error("the address to listen on must be an IP address"))
            }
            "udpout" => (host.trim_matches(['[', ']']), port)
                .to_socket_addrs()
                .ok()
                .and_then(|mut found| found.next())
                .map(Self::UdpOut)
                .ok_or_else(|| error("the host is not known")),
            _ => Err(error("this scheme is not supported")),
        }
    }
}

impl std::fmt::Display for LinkUrl {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::UdpIn(address) => write!(f, "udpin://{address}"),
            Self::UdpOut(address) => write!(f, "udpout://{address}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn urls_mean_what_they_mean_to_mavsdk() {
        let all = LinkUrl::UdpIn("0.0.0.0:14030".parse().unwrap());
        assert_eq!("udpin://0.0.0.0:14030".parse(), Ok(all));
        assert_eq!("udpin://:14030".parse(), Ok(all));
        assert_eq!(all.to_string().parse(), Ok(all));
        let there = LinkUrl::UdpOut("127.0.0.1:14550".parse().unwrap());
        assert_eq!("udpout://127.0.0.1:14550".parse(), Ok(there));
        let v6 = LinkUrl::UdpIn("[::1]:14030".parse().unwrap());
        assert_eq!("udpin://[::1]:14030".parse(), Ok(v6));
        assert_eq!(v6.to_string().parse(), Ok(v6));
    }

    #[test]
    fn what_is_not_understood_is_told_with_what_would_be() {
        for (url, reason) in [
            ("14030", "no scheme"),
            ("udpin://0.0.0.0", "port"),
            ("udpin://0.0.0.0:0", "1 to 65535"),
            ("udpin://0.0.0.0:99999", "1 to 65535"),
            ("udpin://vehicle:14030", "IP address"),
            ("udpout://:14030", "not known"),
            ("serial:///dev/ttyUSB0:57600", "not supported"),
        ] {
            let error = url.parse::<LinkUrl>().unwrap_err().to_string();
            assert!(error.contains(reason) && error.contains("udpout://"), "{url}: {error}");
        }
    }
}
