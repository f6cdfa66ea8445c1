//! `isocat virtual` with programs that behave badly: each ends with a clear word, in bounded time
//! and memory.
#![cfg(all(target_os = "linux", target_arch = "x86_64"))]

use std::process::{Command, Output};

use isocat_host::RawSocket;

use crate::supervised::{Folder, ISOCAT, cannot_be_supervised, in_the_role, role};

fn isocat(arguments: &[&str]) -> Output {
    let output = Command::new(ISOCAT).arg("virtual").args(arguments).output();
    output.expect("the command runs")
}

/// What the command said on standard error, and its exit code; `None`: programs can't be supervised
/// here.
fn told(output: &Output) -> Option<(String, Option<i32>)> {
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    (!cannot_be_supervised(&errors)).then(|| (errors, output.status.code()))
}

#[test]
fn a_year_of_sleep_ends_after_an_hour_unless_more_is_allowed() {
    let Some((errors, code)) = told(&isocat(&["--", "sleep", "31536000"])) else { return };
    assert_eq!(code, Some(3), "{errors}");
    assert!(errors.contains("as its time (--for) was over, after 3600.000000 s"), "{errors}");
    let Some((errors, code)) = told(&isocat(&["--for", "3601s", "--", "sleep", "3600"])) else {
        return;
    };
    assert_eq!(code, Some(3), "{errors}");
    assert!(errors.contains("ended with exit code 0"), "{errors}");
    let refused = isocat(&["--for", "86401s", "--", "sleep", "31536000"]);
    let errors = String::from_utf8_lossy(&refused.stderr);
    assert!(refused.status.code() == Some(2) && errors.contains("up to 24 hours"), "{errors}");
}

#[test]
fn what_it_prints_goes_through_whole() {
    let output = isocat(&["--", "head", "-c", "50000000", "/dev/zero"]);
    let Some((errors, code)) = told(&output) else { return };
    assert_eq!((code, output.stdout.len()), (Some(3), 50_000_000), "{errors}");
}

#[test]
fn a_program_that_leaves_a_child_behind_ends_with_it() {
    let Some((errors, code)) = told(&isocat(&["--", "sh", "-c", "sleep 5000 & exit 6"])) else {
        return;
    };
    assert_eq!(code, Some(4), "{errors}");
    assert!(
        errors.contains("ended with exit code 6") && errors.contains("2 processes"),
        "{errors}"
    );
}

#[test]
fn a_program_for_another_machine_is_refused() {
    let path = std::env::temp_dir().join(format!("isocat-vt-arm-{}", std::process::id()));
    // The head of an ELF file of 64 bits for AArch64 (183), and of one of 32 bits.
    for (class, machine, expected) in [(2, 183, "number 183"), (1, 3, "of 32 bits")] {
        let mut head = [0u8; 64];
        head[..4].copy_from_slice(b"\x7fELF");
        (head[4], head[5], head[18]) = (class, 1, machine);
        std::fs::write(&path, head).expect("it can be written");
        Command::new("chmod").arg("+x").arg(&path).status().expect("chmod");
        let output = isocat(&["--", &path.display().to_string()]);
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(2) && errors.contains(expected), "{errors}");
    }
    let _ = std::fs::remove_file(&path);
}

#[test]
fn garbage_on_the_wire_is_counted_and_harms_nothing() {
    if role().is_some() {
        return send_garbage();
    }
    let test = "virtual_time_unruly::garbage_on_the_wire_is_counted_and_harms_nothing";
    let folder = Folder::new("garbage");
    folder.write("built_in.toml", isocat::SegmentFile::built_in_text());
    let program = in_the_role("sends-garbage", test);
    let Some(told) = folder.supervised("built_in.toml", &["sh", "-c", &program]) else { return };
    assert_eq!(told.exit, Some(3), "{}", told.errors);
    assert_eq!(told.code(), Some(0), "{}", told.errors);
    assert_eq!(told.summary["program"]["frames_sent"], 2_000, "{}", told.errors);
}

/// Frames of all lengths, of any content behind a head of EtherCAT's and without one.
fn send_garbage() {
    let mut socket = RawSocket::open("vt0", None).expect("a packet socket without any rights");
    let mut word = 1u32;
    let mut next = || {
        word ^= word << 13;
        word ^= word >> 17;
        word ^= word << 5;
        word as u8
    };
    for number in 0..2_000usize {
        let mut frame: Vec<u8> = (0..14 + number * 7 % 1_501).map(|_| next()).collect();
        if number % 4 > 0 {
            frame[12..14].copy_from_slice(&[0x88, 0xA4]);
        }
        socket.send(&frame).expect("it is sent");
        let mut buffer = [0; 1_600];
        while socket.receive(&mut buffer).expect("the link is up").is_some() {}
    }
}
