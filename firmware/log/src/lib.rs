//! The flight log: one MCAP file and a tlog, written off the loop's path.
