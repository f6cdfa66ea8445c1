//! Opens a packet socket on a network interface; the sending and the listening socket share this.

use std::os::fd::{AsFd, OwnedFd};

use rustix::io::Errno;

use super::{LinkError, namespace, sys};

/// The frames that a packet socket receives.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Hears {
    /// Frames that come in only.
    Arrivals,
    /// Frames that come in, and those that this machine sends.
    BothWays,
}

/// Opens `interface` of the present network namespace, or of the named one, with time stamps.
/// Returns the socket and the kernel's number of the interface. Each of `options` (level, name,
/// value) is optional and may fail.
pub(super) fn open(
    interface: &str,
    namespace: Option<&str>,
    options: &[(i32, i32, i32)],
    hears: Hears,
) -> Result<(OwnedFd, u32), LinkError> {
    match namespace {
        None => open_here(interface, options, hears),
        Some(name) => namespace::inside(name, || open_here(interface, options, hears))?,
    }
}

fn open_here(
    interface: &str,
    options: &[(i32, i32, i32)],
    hears: Hears,
) -> Result<(OwnedFd, u32), LinkError> {
    let failed = |what| move |error| LinkError::os(what, interface, error);
    let socket = sys::packet_socket().map_err(failed("opening a raw socket for"))?;
    let index = rustix::net::netdevice::name_to_index(&socket, interface)
        .map_err(|_| LinkError::unknown_interface(interface))?;
    let fd = socket.as_fd();
    for (level, name, value) in options {
        let _ = sys::set_option(fd, *level, *name, *value);
    }
    sys::set_option(fd, libc::SOL_SOCKET, libc::SO_TIMESTAMPNS, 1)
        .map_err(failed("asking for receive time stamps of"))?;
    sys::bind(fd, index, hears == Hears::BothWays).map_err(failed("binding a raw socket to"))?;
    match rustix::net::sockopt::socket_error(fd) {
        Ok(Ok(())) => Ok((socket, index)),
        Ok(Err(Errno::NETDOWN)) => Err(LinkError::Down(interface.to_owned())),
        Ok(Err(error)) | Err(error) => Err(failed("binding a raw socket to")(error.into())),
    }
}
