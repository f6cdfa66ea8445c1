use std::os::unix::fs::PermissionsExt;

use super::*;

/// A socket in a folder of this test, which only this user can enter.
fn socket(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("isocat-control-{}-{name}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::DirBuilder::new().mode(0o700).create(&folder).expect("a folder");
    folder.join("isocat-test.sock")
}

fn remove(path: &Path) {
    let _ = std::fs::remove_dir_all(path.parent().expect("a folder"));
}

/// A service that answers each request with the request itself, until "stop".
fn echo(requests: Requests) -> std::thread::JoinHandle<()> {
    std::thread::spawn(move || {
        let mut stop = false;
        while !stop {
            std::thread::sleep(Duration::from_millis(1));
            requests.answer(|request| {
                stop |= request == "stop";
                request.to_owned()
            });
        }
        // The last answer is still under way.
        std::thread::sleep(Duration::from_millis(100));
    })
}

#[test]
fn clients_that_say_nothing_do_not_lock_a_request_out() {
    let path = socket("silent");
    let (requests, _wake) = Requests::listen(&path).expect("our own folder");
    let service = echo(requests);
    let mut silent = Vec::new();
    for _ in 0..limits::CONTROL_CLIENTS * 2 {
        let mut client = UnixStream::connect(&path).expect("somebody listens");
        client.write_all(b"half a requ").expect("it is taken");
        silent.push(client);
    }
    // Far below the two seconds that each silent client has.
    let begun = Instant::now();
    assert_eq!(request(&path, "stop").expect("answered"), "stop\n");
    assert!(begun.elapsed() < CLIENT, "{:?}", begun.elapsed());
    service.join().expect("no panic");
    remove(&path);
}

#[test]
fn a_server_without_end_and_one_that_drips_are_left() {
    for (name, pause, chunk) in [("flood", 0, 1 << 20), ("drip", 20, 1)] {
        let path = socket(name);
        let listener = UnixListener::bind(&path).expect("our own folder");
        let server = std::thread::spawn(move || {
            let (mut client, _) = listener.accept().expect("a client");
            let bytes = vec![b'x'; chunk];
            while client.write_all(&bytes).is_ok() {
                std::thread::sleep(Duration::from_millis(pause));
            }
        });
        let stop = AtomicBool::new(false);
        let stream = connect(&path, Instant::now() + CLIENT, &stop).expect("it is ours");
        let until = Instant::now() + Duration::from_millis(300);
        let error = read(&stream, 1 << 20, false, until, &stop).expect_err("no end");
        let expected = match name {
            "flood" => io::ErrorKind::InvalidData,
            _ => io::ErrorKind::TimedOut,
        };
        assert_eq!(error.kind(), expected, "{name}: {error}");
        assert!(until.elapsed() < Duration::from_secs(1), "{name}");
        drop(stream);
        server.join().expect("no panic");
        remove(&path);
    }
}

#[test]
fn a_client_that_is_to_stop_stops_at_once() {
    let path = socket("stop");
    // This listener takes clients into its queue and never answers.
    let _listener = UnixListener::bind(&path).expect("our own folder");
    let stop = Arc::new(AtomicBool::new(false));
    let (setter, begun) = (stop.clone(), Instant::now());
    std::thread::spawn(move || {
        std::thread::sleep(Duration::from_millis(100));
        setter.store(true, Ordering::Relaxed);
    });
    let error = request_until(&path, "watch", &stop).expect_err("nobody answers");
    assert_eq!(error.kind(), io::ErrorKind::Interrupted);
    assert!(begun.elapsed() < CLIENT, "{:?}", begun.elapsed());
    remove(&path);
}

#[test]
fn a_folder_that_others_can_write_to_is_refused() {
    let path = socket("shared");
    let folder = path.parent().expect("a folder");
    let set = |mode| {
        std::fs::set_permissions(folder, std::fs::Permissions::from_mode(mode)).expect("ours");
    };
    for (mode, safe) in
        [(0o700, true), (0o755, true), (0o777, false), (0o770, false), (0o1777, true)]
    {
        set(mode);
        let checked = check_folder(&path);
        assert_eq!(checked.is_ok(), safe, "{mode:o}: {checked:?}");
    }
    set(0o777);
    let refused = Requests::listen(&path).err().expect("refused");
    assert_eq!(refused.kind(), io::ErrorKind::PermissionDenied, "{refused}");
    assert!(refused.to_string().contains("expected one of user"), "{refused}");
    remove(&path);
}

/// Only root can make a socket of another user, so only root can run this test.
#[test]
fn a_socket_of_another_user_is_not_asked() {
    if !rustix::process::geteuid().is_root() {
        println!("skipped: only root can give a socket to another user");
        return;
    }
    let path = socket("foreign");
    let _listener = UnixListener::bind(&path).expect("our own folder");
    std::os::unix::fs::chown(&path, Some(12_345), None).expect("root may");
    let error = request(&path, "status").expect_err("refused");
    assert_eq!(error.kind(), io::ErrorKind::PermissionDenied);
    assert!(error.to_string().contains("belongs to user 12345"), "{error}");
    remove(&path);
}
