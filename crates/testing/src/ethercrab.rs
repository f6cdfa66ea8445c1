//! Connects ethercrab to the segment.
//!
//! This package does not depend on ethercrab: the macro generates code in the test's own package,
//! for the version of ethercrab that the application uses.

use crate::clock::Clock;

/// Sends and receives the frames of a MainDevice of ethercrab, like its function `tx_rx_task` at a
/// network interface.
///
/// Takes a [`Bus`](crate::Bus), a `PduTx` and a `PduRx`; returns a future, which must be spawned.
/// It ends when the MainDevice is released, or with an error on a frame that ethercrab does not
/// know, as that function does. ethercrab must be built without its feature `std`, so that its
/// timers are those of embassy-time.
///
/// ```text
/// let (tx, rx, pdu_loop) = storage.try_split().expect("storage is split once");
/// let frames = isocat_testing::ethercrab_tx_rx_task!(bus, tx, rx);
/// let _runs_on = bus.spawn(async { frames.await.expect("frames are sent and received") });
/// ```
///
/// # Panics
///
/// The future panics if ethercrab was built with `std`: ethercrab would wait for the machine's
/// clock, and the run for ethercrab.
#[macro_export]
macro_rules! ethercrab_tx_rx_task {
    ($bus:expr, $tx:expr, $rx:expr $(,)?) => {{
        use ::std::task::Poll;
        let socket = $bus.socket();
        let mut halves = ::std::option::Option::Some(($tx, $rx));
        ::std::future::poll_fn(move |context| {
            let Some((tx, rx)) = halves.as_mut() else { return Poll::Pending };
            tx.replace_waker(context.waker());
            if tx.should_exit() {
                let ended = halves.take().map(|(tx, rx)| (tx.release(), rx.release()));
                return ended.map_or(Poll::Pending, |halves| Poll::Ready(Ok(halves)));
            }
            while let Some(frame) = tx.next_sendable_frame() {
                $crate::assert_virtual_timers();
                let sent = frame.send_blocking(|bytes| {
                    socket.send(bytes);
                    Ok(bytes.len())
                });
                if let Err(error) = sent {
                    return Poll::Ready(Err(error));
                }
            }
            while let Poll::Ready(frame) = socket.poll_receive(context) {
                if let Err(error) = rx.receive_frame(&frame) {
                    return Poll::Ready(Err(error));
                }
            }
            Poll::Pending
        })
    }};
}

/// For [`ethercrab_tx_rx_task`]: a stack that sends a frame with a time-out in virtual time has
/// asked for a timer.
#[doc(hidden)]
pub fn assert_virtual_timers() {
    assert!(
        Clock::of_this_thread().has_embassy_asked(),
        "ethercrab sends a frame and asked embassy-time for no timer: it was built with its feature `std` and waits for the machine's \
         clock; expected `default-features = false`, and nothing else in this build that asks for `std` (`cargo tree -e features \
         -i ethercrab` tells)"
    );
}
