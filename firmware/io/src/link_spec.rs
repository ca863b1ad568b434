//! A link among several: where it is, who may speak on it, how much it carries.

use crate::gate::AllowUnsigned;
use crate::link_url::{LinkUrl, LinkUrlError};
use std::str::FromStr;
use vigil_types::Nanos;
use vigil_types::settings::{parsed, value_setting};

/// Bits on a serial line for each byte.
const BITS_PER_BYTE: f64 = 10.0;
/// A link that was quiet may send this much at once: a burst of a file transfer's.
const BURST_S: f64 = 0.25;
/// A burst has room for the longest packet, also where a quarter of it is kept.
const LEAST_BURST_BYTES: f64 = 400.0;

/// How often a link that leaves this machine gets the guidance computer's values unless it is given: often enough to watch,
/// a twelfth of a 57 600 baud radio.
const VALUES_HZ: f32 = 1.0;
/// The guidance computer sends them four times a second.
const MAX_VALUES_HZ: f32 = 4.0;
/// Share of a link's rate that values take at most unless it is given, and the bytes of all of them once.
const VALUES_SHARE: f32 = 0.1;
const VALUES_BYTES: f32 = 650.0;

/// A link among several: `URL[,OPTION…]` with the options `unsigned=loopback|never|always`, `rate=BYTES_PER_SECOND`,
/// `values=PER_SECOND` and `system=ID`.
#[derive(Debug, Clone, PartialEq)]
pub struct LinkSpec {
    /// Where.
    pub url: LinkUrl,
    /// From whom packets without a signature are accepted; the policy for all links if absent.
    pub allow_unsigned: Option<AllowUnsigned>,
    /// Most bytes that are sent in a second; a serial line's own speed if absent.
    pub rate_bytes_s: Option<u32>,
    /// How often the guidance computer's values are sent in a second, 0 to 4; 0 sends changes of state only.
    pub values_hz: Option<f32>,
    /// The system of the vehicle on the link: nobody else may become its peer.
    pub system: Option<u8>,
}

/// A link that is not understood.
#[derive(Debug, thiserror::Error)]
pub enum LinkSpecError {
    /// Its URL.
    #[error(transparent)]
    Url(#[from] LinkUrlError),
    /// What follows the URL.
    #[error(
        "link option `{0}`: use unsigned=loopback, unsigned=never, unsigned=always, rate=BYTES_PER_SECOND (1000 or more), \
         values=PER_SECOND (0 to 4) or system=ID (of the vehicle, 1 to 255)"
    )]
    Option(String),
}

impl LinkSpec {
    /// Bytes per second that the link carries; `None` if there is no limit.
    pub fn bytes_per_s(&self) -> Option<f64> {
        let line = match self.url {
            LinkUrl::Serial { baud, .. } => Some(f64::from(baud) / BITS_PER_BYTE),
            _ => None,
        };
        self.rate_bytes_s.map(f64::from).or(line)
    }

    /// How often the guidance computer's values are sent in a second; `None` if as often as they come. Fewer where the
    /// link leaves this machine, or is slow: it may be a radio, or end in one.
    pub fn values_per_s(&self) -> Option<f32> {
        if self.values_hz.is_some() {
            return self.values_hz;
        }
        let affordable = self.bytes_per_s().map(|rate| rate as f32 * VALUES_SHARE / VALUES_BYTES);
        let wanted = if self.url.is_on_this_machine() {
            MAX_VALUES_HZ
        } else {
            VALUES_HZ
        };
        let per_s = affordable.map_or(wanted, |affordable| affordable.min(wanted));
        (per_s < MAX_VALUES_HZ).then_some(per_s)
    }
}

impl From<LinkUrl> for LinkSpec {
    fn from(url: LinkUrl) -> Self {
        Self {
            url,
            allow_unsigned: None,
            rate_bytes_s: None,
            values_hz: None,
            system: None,
        }
    }
}

impl FromStr for LinkSpec {
    type Err = LinkSpecError;

    fn from_str(text: &str) -> Result<Self, LinkSpecError> {
        let mut parts = text.split(',');
        let mut link = Self::from(parts.next().unwrap_or_default().parse::<LinkUrl>()?);
        for option in parts {
            let bad = || LinkSpecError::Option(option.to_owned());
            match option.split_once('=') {
                Some(("unsigned", policy)) => {
                    link.allow_unsigned = Some(AllowUnsigned::from_name(policy).ok_or_else(bad)?);
                }
                Some(("rate", rate)) => {
                    link.rate_bytes_s = Some(rate.parse().ok().filter(|r| *r >= 1000).ok_or_else(bad)?);
                }
                Some(("values", per_s)) => {
                    let per_s = per_s.parse().ok().filter(|v| (0.0..=MAX_VALUES_HZ).contains(v));
                    link.values_hz = Some(per_s.ok_or_else(bad)?);
                }
                Some(("system", id)) => {
                    link.system = Some(id.parse().ok().filter(|id| *id > 0).ok_or_else(bad)?);
                }
                _ => return Err(bad()),
            }
        }
        Ok(link)
    }
}

impl std::fmt::Display for LinkSpec {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.url)?;
        self.allow_unsigned
            .map_or(Ok(()), |policy| write!(f, ",unsigned={}", policy.name()))?;
        self.rate_bytes_s.map_or(Ok(()), |rate| write!(f, ",rate={rate}"))?;
        self.values_hz.map_or(Ok(()), |per_s| write!(f, ",values={per_s}"))?;
        self.system.map_or(Ok(()), |id| write!(f, ",system={id}"))
    }
}

value_setting!(LinkSpec, parsed, ToString::to_string);

/// Bytes that a link may still send, refilled as time passes.
#[derive(Debug, Clone)]
pub struct Budget {
    bytes_per_s: f64,
    burst_bytes: f64,
    bytes: f64,
    last_ns: Nanos,
}

impl Budget {
    /// A link's, full; at most `burst_bytes` of what was not used are kept. `None` for one without a limit.
    pub fn of(link: &LinkSpec, burst_bytes: f64) -> Option<Self> {
        let bytes_per_s = link.bytes_per_s()?;
        let burst_bytes = burst_bytes.min((bytes_per_s * BURST_S).max(LEAST_BURST_BYTES));
        Some(Self {
            bytes_per_s,
            burst_bytes,
            bytes: burst_bytes,
            last_ns: 0,
        })
    }

    fn refill(&mut self, now_ns: Nanos) {
        let elapsed_s = now_ns.saturating_sub(self.last_ns) as f64 * 1e-9;
        self.last_ns = now_ns;
        self.bytes = (self.bytes + elapsed_s * self.bytes_per_s).min(self.burst_bytes);
    }

    /// Takes `len` bytes if they are there and `kept`, a fraction of a burst, remains (negative: may be overdrawn by it); returns whether it did.
    pub fn spend(&mut self, now_ns: Nanos, len: usize, kept: f64) -> bool {
        self.refill(now_ns);
        let fits = self.bytes - len as f64 >= kept * self.burst_bytes;
        if fits {
            self.bytes -= len as f64;
        }
        fits
    }

    /// Takes `len` bytes whether they are there or not: others wait until that is made up for.
    pub fn charge(&mut self, now_ns: Nanos, len: usize) {
        self.refill(now_ns);
        self.bytes = (self.bytes - len as f64).max(-self.burst_bytes);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_link_is_written_as_a_url_with_options_and_read_back() {
        let text = "udpin://127.0.0.1:7000,unsigned=never,rate=5000";
        let link: LinkSpec = text.parse().unwrap();
        assert_eq!(
            (link.allow_unsigned, link.rate_bytes_s),
            (Some(AllowUnsigned::Never), Some(5000))
        );
        for text in [
            text,
            "tcpin://0.0.0.0:5760,unsigned=always",
            "udpout://10.0.0.2:14550,unsigned=loopback",
            "serial:///dev/ttyUSB0:57600",
            "serial:///dev/ttyUSB0:57600,rate=4000,values=0.5,system=3",
        ] {
            assert_eq!(text.parse::<LinkSpec>().unwrap().to_string(), text);
        }
        for bad in [
            "udpin://127.0.0.1:7000,unsigned=maybe",
            "tcpin://127.0.0.1:1,rate=5",
            "tcpin://127.0.0.1:1,x",
            "tcpin://127.0.0.1:1,values=5",
            "tcpin://127.0.0.1:1,values=NaN",
            "tcpin://127.0.0.1:1,system=0",
            "tcpin://127.0.0.1:1,system=256",
        ] {
            let error = bad.parse::<LinkSpec>().unwrap_err().to_string();
            assert!(error.contains("rate=BYTES_PER_SECOND"), "{error}");
        }
        let error = "ftp://x".parse::<LinkSpec>().unwrap_err().to_string();
        assert!(error.contains("udpout://"), "{error}");
    }

    #[test]
    fn a_slow_link_sends_long_packets_seldom_but_does() {
        let link: LinkSpec = "serial:///dev/ttyUSB0:9600".parse().unwrap();
        let mut budget = Budget::of(&link, 4096.0).unwrap();
        assert!(budget.spend(0, 280, 0.25));
        assert!(!budget.spend(100_000_000, 280, 0.25));
        assert!(budget.spend(1_000_000_000, 280, 0.25));
    }

    #[test]
    fn values_are_rare_where_the_link_leaves_this_machine_or_is_slow() {
        let per_s = |text: &str| text.parse::<LinkSpec>().unwrap().values_per_s();
        for here in [
            "udpout://127.0.0.1:1",
            "tcpin://[::1]:1",
            "udpin://127.0.0.1:1,rate=100000",
        ] {
            assert_eq!(per_s(here), None, "{here}");
        }
        for away in [
            "udpin://0.0.0.0:1",
            "udpout://10.0.0.2:14550",
            "tcpout://10.0.0.2:1",
            "serial:///dev/ttyACM0:921600",
        ] {
            assert_eq!(per_s(away), Some(1.0), "{away}");
        }
        for (slow, wanted) in [
            ("serial:///dev/ttyUSB0:57600", 0.886),
            ("serial:///dev/ttyUSB0:9600", 0.148),
            ("udpout://127.0.0.1:1,rate=6500", 1.0),
            ("serial:///dev/ttyUSB0:9600,values=2", 2.0),
        ] {
            assert!(
                (per_s(slow).unwrap() - wanted).abs() < 0.01,
                "{slow}: {:?}",
                per_s(slow)
            );
        }
    }

    #[test]
    fn a_budget_gives_no_more_than_its_rate_and_keeps_what_it_is_asked_to() {
        let link: LinkSpec = "serial:///dev/ttyUSB0:20000".parse().unwrap();
        let mut budget = Budget::of(&link, f64::INFINITY).unwrap();
        let taken = (0..10_000).filter(|ms| budget.spend(ms * 1_000_000, 20, 0.0)).count() * 20;
        assert!((19_900..=20_520).contains(&taken), "{taken} bytes in 10 s");
        let now_ns = 20_000_000_000;
        while budget.spend(now_ns, 10, 0.5) {}
        assert!(
            budget.spend(now_ns, 240, 0.0),
            "half of the burst of 500 bytes was kept"
        );
        budget.charge(now_ns, 400);
        assert!(
            !budget.spend(now_ns + 100_000_000, 1, 0.0),
            "200 bytes have not made up for it"
        );
        assert!(Budget::of(&"tcpin://127.0.0.1:1".parse().unwrap(), 1.0).is_none());
    }
}
