//! The few system calls without a safe wrapper in a library: all unsafe code of this crate is here.
#![expect(unsafe_code, reason = "packet sockets and real-time scheduling have no safe wrapper")]

use std::io;
use std::mem::{MaybeUninit, size_of};
use std::os::fd::{AsRawFd, BorrowedFd, FromRawFd, OwnedFd};

use rustix::io::Errno;

/// EtherType of EtherCAT, as the kernel wants it.
const PROTOCOL: u16 = (0x88A4_u16).to_be();

/// The protocol number for frames of any protocol.
const EVERY_PROTOCOL: u16 = (libc::ETH_P_ALL as u16).to_be();

/// A packet socket that receives nothing yet.
pub(super) fn packet_socket() -> io::Result<OwnedFd> {
    let kind = libc::SOCK_RAW | libc::SOCK_CLOEXEC | libc::SOCK_NONBLOCK;
    // SAFETY: no pointers are passed; a descriptor that is not negative is ours alone.
    unsafe {
        let fd = libc::socket(libc::AF_PACKET, kind, 0);
        if fd < 0 { Err(io::Error::last_os_error()) } else { Ok(OwnedFd::from_raw_fd(fd)) }
    }
}

/// Binds a packet socket to EtherCAT frames of one interface; `all`: to all frames, including those
/// that this machine sends.
pub(super) fn bind(socket: BorrowedFd<'_>, interface: u32, all: bool) -> io::Result<()> {
    // SAFETY: all-zero is a valid address; its length is passed with it.
    let result = unsafe {
        let mut address: libc::sockaddr_ll = MaybeUninit::zeroed().assume_init();
        address.sll_family = libc::AF_PACKET as u16;
        address.sll_protocol = if all { EVERY_PROTOCOL } else { PROTOCOL };
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

/// Lets an interface receive frames to any address while the socket is open.
pub(super) fn hear_all(socket: BorrowedFd<'_>, interface: u32) -> io::Result<()> {
    // SAFETY: all-zero is a valid request; it outlives the call and its size is passed with it.
    let result = unsafe {
        let mut request: libc::packet_mreq = MaybeUninit::zeroed().assume_init();
        request.mr_ifindex = interface as i32;
        request.mr_type = libc::PACKET_MR_PROMISC as u16;
        libc::setsockopt(
            socket.as_raw_fd(),
            libc::SOL_PACKET,
            libc::PACKET_ADD_MEMBERSHIP,
            (&raw const request).cast(),
            size_of::<libc::packet_mreq>() as u32,
        )
    };
    if result < 0 { Err(io::Error::last_os_error()) } else { Ok(()) }
}

/// Number of frames that the kernel dropped since the last call because the queue was full.
pub(super) fn dropped(socket: BorrowedFd<'_>) -> io::Result<u32> {
    // SAFETY: all-zero is a valid value; it outlives the call and its size is passed with it.
    unsafe {
        let mut statistics: libc::tpacket_stats = MaybeUninit::zeroed().assume_init();
        let mut len = size_of::<libc::tpacket_stats>() as u32;
        let result = libc::getsockopt(
            socket.as_raw_fd(),
            libc::SOL_PACKET,
            libc::PACKET_STATISTICS,
            (&raw mut statistics).cast(),
            &raw mut len,
        );
        if result < 0 { Err(io::Error::last_os_error()) } else { Ok(statistics.tp_drops) }
    }
}

/// One frame as the kernel returned it.
pub(super) struct Taken {
    /// Its length on the wire, which may exceed the buffer.
    pub len: usize,
    /// The kernel's stamp of its arrival, as `CLOCK_REALTIME` shows it, ns.
    pub stamp: Option<u64>,
    /// Whether this machine sent it.
    pub outgoing: bool,
}

/// Takes one frame, if one has arrived. `asks`: whether this machine sent it is of interest.
#[inline(always)]
pub(super) fn receive(
    socket: BorrowedFd<'_>,
    buffer: &mut [u8],
    asks: bool,
) -> Result<Taken, Errno> {
    let mut part = libc::iovec { iov_base: buffer.as_mut_ptr().cast(), iov_len: buffer.len() };
    // The type gives the alignment that control messages need.
    let mut control = [MaybeUninit::<libc::cmsghdr>::uninit(); 8];
    // SAFETY: all pointers in the header are to locals that outlive the call, with their lengths;
    // the control messages are walked by the macros made for it, and a stamp is read as the kernel
    // wrote it.
    unsafe {
        let mut header: libc::msghdr = MaybeUninit::zeroed().assume_init();
        let mut from: libc::sockaddr_ll = MaybeUninit::zeroed().assume_init();
        if asks {
            header.msg_name = (&raw mut from).cast();
            header.msg_namelen = size_of::<libc::sockaddr_ll>() as u32;
        }
        header.msg_iov = &raw mut part;
        header.msg_iovlen = 1;
        header.msg_control = control.as_mut_ptr().cast();
        header.msg_controllen = size_of_val(&control);
        let flags = libc::MSG_DONTWAIT | libc::MSG_TRUNC;
        // The function of the C library of this name is a point where threads may be cancelled,
        // which costs more than the call.
        let socket = libc::c_long::from(socket.as_raw_fd());
        let len =
            libc::syscall(libc::SYS_recvmsg, socket, &raw mut header, libc::c_long::from(flags));
        if len < 0 {
            return Err(last_error());
        }
        let mut stamp = None;
        let mut message = libc::CMSG_FIRSTHDR(&raw const header);
        while !message.is_null() {
            let kind = ((*message).cmsg_level, (*message).cmsg_type);
            if kind == (libc::SOL_SOCKET, libc::SCM_TIMESTAMPNS) {
                let time: libc::timespec =
                    libc::CMSG_DATA(message).cast::<libc::timespec>().read_unaligned();
                stamp = Some(nanos(time));
                break;
            }
            message = libc::CMSG_NXTHDR(&raw const header, message);
        }
        let outgoing = asks && from.sll_pkttype == libc::PACKET_OUTGOING;
        Ok(Taken { len: len as usize, stamp, outgoing })
    }
}

/// The error of the last call.
#[cold]
fn last_error() -> Errno {
    Errno::from_io_error(&io::Error::last_os_error()).unwrap_or(Errno::IO)
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

/// What a clock of the system shows, ns. Read by the C library: it needs no system call, and tools
/// that count instructions can follow it.
#[inline]
pub(super) fn clock(number: libc::clockid_t) -> u64 {
    let mut time = MaybeUninit::<libc::timespec>::zeroed();
    // SAFETY: the time outlives the call, and all-zero is a valid one.
    let time = unsafe {
        libc::clock_gettime(number, time.as_mut_ptr());
        time.assume_init()
    };
    nanos(time)
}

fn nanos(time: libc::timespec) -> u64 {
    time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64
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

/// How an interface collects arrivals before it raises an interrupt.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) struct Coalescing {
    /// Microseconds that it waits for more frames.
    pub usecs: u32,
    /// Whether the driver chooses the wait itself.
    pub adaptive: bool,
}

/// Reads how received frames are collected (`ethtool -c`).
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
    // The last byte must stay 0.
    if interface.len() >= request.ifr_name.len() {
        return Err(io::ErrorKind::InvalidInput.into());
    }
    for (to, from) in request.ifr_name.iter_mut().zip(interface.bytes()) {
        *to = from as libc::c_char;
    }
    Ok(request)
}
