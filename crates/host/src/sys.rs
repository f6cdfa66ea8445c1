//! The few system calls that no library wraps safely: everything unsafe of the project stands here.
#![expect(unsafe_code, reason = "packet sockets and real-time scheduling have no safe wrapper")]

use std::io;
use std::mem::{MaybeUninit, size_of};
use std::os::fd::{AsRawFd, BorrowedFd, FromRawFd, OwnedFd};
use std::time::Duration;

/// EtherType of EtherCAT, as the kernel wants it.
const PROTOCOL: u16 = (0x88A4_u16).to_be();

/// A packet socket that hears nothing yet.
pub(super) fn packet_socket() -> io::Result<OwnedFd> {
    let kind = libc::SOCK_RAW | libc::SOCK_CLOEXEC | libc::SOCK_NONBLOCK;
    // SAFETY: no pointers are passed; a descriptor that is not negative is ours alone.
    unsafe {
        let fd = libc::socket(libc::AF_PACKET, kind, 0);
        if fd < 0 { Err(io::Error::last_os_error()) } else { Ok(OwnedFd::from_raw_fd(fd)) }
    }
}

/// Binds a packet socket to EtherCAT frames of one interface.
pub(super) fn bind(socket: BorrowedFd<'_>, interface: u32) -> io::Result<()> {
    // SAFETY: all-zero is a valid address; its length is passed with it.
    let result = unsafe {
        let mut address: libc::sockaddr_ll = MaybeUninit::zeroed().assume_init();
        address.sll_family = libc::AF_PACKET as u16;
        address.sll_protocol = PROTOCOL;
        address.sll_ifindex = interface as i32;
        libc::bind(
            socket.as_raw_fd(),
            (&raw const address).cast(),
            size_of::<libc::sockaddr_ll>() as u32,
        )
    };
    if result < 0 { Err(io::Error::last_os_error()) } else { Ok(()) }
}

/// Sets an option whose value is a number.
pub(super) fn set_option(
    socket: BorrowedFd<'_>,
    level: i32,
    name: i32,
    value: i32,
) -> io::Result<()> {
    // SAFETY: the value outlives the call and its size is passed with it.
    let result = unsafe {
        libc::setsockopt(
            socket.as_raw_fd(),
            level,
            name,
            (&raw const value).cast(),
            size_of::<i32>() as u32,
        )
    };
    if result < 0 { Err(io::Error::last_os_error()) } else { Ok(()) }
}

/// Takes one frame, if there is one: its length on the wire (which may be beyond the buffer) and the
/// kernel's stamp of its arrival, as `CLOCK_REALTIME` shows it.
pub(super) fn receive(
    socket: BorrowedFd<'_>,
    buffer: &mut [u8],
) -> io::Result<(usize, Option<Duration>)> {
    let mut part = libc::iovec { iov_base: buffer.as_mut_ptr().cast(), iov_len: buffer.len() };
    // Of the type that gives it the alignment that control messages need.
    let mut control = [MaybeUninit::<libc::cmsghdr>::uninit(); 8];
    // SAFETY: all pointers in the header are to locals that outlive the call, with their lengths; the
    // control messages are walked by the macros made for it, and a stamp is read as the kernel wrote it.
    unsafe {
        let mut header: libc::msghdr = MaybeUninit::zeroed().assume_init();
        header.msg_iov = &raw mut part;
        header.msg_iovlen = 1;
        header.msg_control = control.as_mut_ptr().cast();
        header.msg_controllen = size_of_val(&control);
        let flags = libc::MSG_DONTWAIT | libc::MSG_TRUNC;
        let len = libc::recvmsg(socket.as_raw_fd(), &raw mut header, flags);
        if len < 0 {
            return Err(io::Error::last_os_error());
        }
        let mut stamp = None;
        let mut message = libc::CMSG_FIRSTHDR(&raw const header);
        while !message.is_null() {
            let kind = ((*message).cmsg_level, (*message).cmsg_type);
            if kind == (libc::SOL_SOCKET, libc::SCM_TIMESTAMPNS) {
                let time: libc::timespec =
                    libc::CMSG_DATA(message).cast::<libc::timespec>().read_unaligned();
                let seconds = u64::try_from(time.tv_sec).unwrap_or(0);
                stamp = Some(Duration::new(seconds, u32::try_from(time.tv_nsec).unwrap_or(0)));
            }
            message = libc::CMSG_NXTHDR(&raw const header, message);
        }
        Ok((len as usize, stamp))
    }
}

/// Puts the calling thread under `SCHED_FIFO` with this priority, 1 to 99.
pub(super) fn schedule_fifo(priority: i32) -> io::Result<()> {
    // SAFETY: all-zero is a valid parameter block; it outlives the call.
    let result = unsafe {
        let mut parameters: libc::sched_param = MaybeUninit::zeroed().assume_init();
        parameters.sched_priority = priority;
        libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const parameters)
    };
    if result < 0 { Err(io::Error::last_os_error()) } else { Ok(()) }
}

/// Sleeps until `CLOCK_MONOTONIC` shows this; a signal ends it early.
pub(super) fn sleep_until(at: Duration) {
    let until =
        libc::timespec { tv_sec: at.as_secs() as libc::time_t, tv_nsec: at.subsec_nanos().into() };
    // SAFETY: the time outlives the call; no remainder is asked for.
    unsafe {
        libc::clock_nanosleep(
            libc::CLOCK_MONOTONIC,
            libc::TIMER_ABSTIME,
            &raw const until,
            std::ptr::null_mut(),
        );
    }
}

/// Whether the interface is up and its cable has a signal.
pub(super) fn has_carrier(socket: BorrowedFd<'_>, interface: &str) -> io::Result<bool> {
    let mut request = interface_request(interface)?;
    // SAFETY: the request outlives the call; the kernel fills the member that is read.
    let flags = unsafe {
        if libc::ioctl(socket.as_raw_fd(), libc::SIOCGIFFLAGS as _, &raw mut request) < 0 {
            return Err(io::Error::last_os_error());
        }
        request.ifr_ifru.ifru_flags
    };
    Ok(i32::from(flags) & libc::IFF_RUNNING != 0)
}

/// How an interface gathers arrivals before it interrupts.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Coalescing {
    /// It waits so many microseconds for more frames.
    pub usecs: u32,
    /// The driver chooses that by itself.
    pub adaptive: bool,
}

/// Reads how received frames are gathered (`ethtool -c`).
pub(super) fn coalescing(socket: BorrowedFd<'_>, interface: &str) -> io::Result<Coalescing> {
    /// `struct ethtool_coalesce`: the command and 22 settings.
    const WORDS: usize = 23;
    const ETHTOOL_GCOALESCE: u32 = 0x0E;
    let mut words = [0_u32; WORDS];
    words[0] = ETHTOOL_GCOALESCE;
    let mut request = interface_request(interface)?;
    request.ifr_ifru.ifru_data = words.as_mut_ptr().cast();
    // SAFETY: request and words outlive the call; the words are as long as the command says.
    let result =
        unsafe { libc::ioctl(socket.as_raw_fd(), libc::SIOCETHTOOL as _, &raw mut request) };
    if result < 0 {
        return Err(io::Error::last_os_error());
    }
    Ok(Coalescing { usecs: words[1], adaptive: words[10] != 0 })
}

fn interface_request(interface: &str) -> io::Result<libc::ifreq> {
    // SAFETY: all-zero is a valid request.
    let mut request: libc::ifreq = unsafe { MaybeUninit::zeroed().assume_init() };
    // The last byte stays 0.
    if interface.len() >= request.ifr_name.len() {
        return Err(io::ErrorKind::InvalidInput.into());
    }
    for (to, from) in request.ifr_name.iter_mut().zip(interface.bytes()) {
        *to = from as libc::c_char;
    }
    Ok(request)
}
