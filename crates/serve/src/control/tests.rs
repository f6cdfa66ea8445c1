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

/// Waits that never end within a test. A service that waits for a silent client makes its test
/// hang, which is seen, and no machine is so slow that a client is given up.
const FOR_EVER: Waits =
    Waits { client: Duration::from_secs(3_600), answer: Duration::from_secs(3_600) };

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
    })
}

fn ask(path: &Path, request: &str) -> io::Result<String> {
    request_with(path, request, &AtomicBool::new(false), FOR_EVER)
}

/// Each silent client may take an hour, and there are more of them than the service keeps. A
/// request is answered all the same, and the oldest clients are disconnected.
#[test]
fn clients_that_say_nothing_do_not_lock_a_request_out() {
    let path = socket("silent");
    let (requests, _wake) = Requests::listen_with(&path, FOR_EVER).expect("our own folder");
    let service = echo(requests);
    let mut silent: VecDeque<_> = (0..limits::CONTROL_CLIENTS * 2)
        .map(|_| {
            let mut client = UnixStream::connect(&path).expect("somebody listens");
            client.write_all(b"half a requ").expect("it is taken");
            client
        })
        .collect();
    assert_eq!(ask(&path, "stop").expect("answered"), "stop\n");
    service.join().expect("no panic");
    // The request was one client more.
    for mut gone in silent.drain(..limits::CONTROL_CLIENTS + 1) {
        // A client whose bytes were not read yet gets a reset in the place of the end.
        let ended = gone.read(&mut [0; 1]);
        assert!(ended.as_ref().is_ok_and(|count| *count == 0) || ended.is_err(), "{ended:?}");
    }
    for mut kept in silent {
        kept.set_nonblocking(true).expect("a socket");
        let waits = kept.read(&mut [0; 1]).map_err(|error| error.kind());
        assert_eq!(waits, Err(io::ErrorKind::WouldBlock));
    }
    remove(&path);
}

/// A client that says nothing is disconnected when its time is over.
#[test]
fn a_client_that_says_nothing_is_left() {
    let path = socket("left");
    let waits = Waits { client: Duration::from_millis(1), ..FOR_EVER };
    let (_requests, _wake) = Requests::listen_with(&path, waits).expect("our own folder");
    let mut client = UnixStream::connect(&path).expect("somebody listens");
    assert_eq!(client.read(&mut [0; 1]).expect("the end"), 0);
    remove(&path);
}

/// A request that the service does not answer in its time is told, and no hang.
#[test]
fn a_service_that_does_not_answer_is_left() {
    let path = socket("mute");
    let waits = Waits { answer: Duration::from_millis(1), ..FOR_EVER };
    let (_requests, _wake) = Requests::listen_with(&path, waits).expect("our own folder");
    assert_eq!(ask(&path, "status").expect("the end"), "", "closed without an answer");
    remove(&path);
}

/// A server that sends for ever: without a pause its answer is too long; a byte now and then, and
/// the time is over first, whenever that is noticed.
#[test]
fn a_server_without_end_and_one_that_drips_are_left() {
    for (name, pause, chunk, wait, expected) in [
        ("flood", 0, 1 << 20, FOR_EVER.client, io::ErrorKind::InvalidData),
        ("drip", 1, 1, Duration::from_millis(30), io::ErrorKind::TimedOut),
    ] {
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
        let stream = connect(&path, Instant::now() + FOR_EVER.client, &stop).expect("it is ours");
        let error =
            read(&stream, 1 << 20, false, Instant::now() + wait, &stop).expect_err("no end");
        assert_eq!(error.kind(), expected, "{name}: {error}");
        drop(stream);
        server.join().expect("no panic");
        remove(&path);
    }
}

/// The service has an hour to answer, so that a client that ignores `stop` hangs.
#[test]
fn a_client_that_is_to_stop_stops() {
    let path = socket("stop");
    // This listener takes clients into its queue and never answers.
    let _listener = UnixListener::bind(&path).expect("our own folder");
    let stop = Arc::new(AtomicBool::new(false));
    let setter = stop.clone();
    let thread = std::thread::spawn(move || {
        // Mostly the client waits by then; one that does not yet must stop as well.
        std::thread::sleep(Duration::from_millis(20));
        setter.store(true, Ordering::Relaxed);
    });
    let error = request_with(&path, "watch", &stop, FOR_EVER).expect_err("nobody answers");
    assert_eq!(error.kind(), io::ErrorKind::Interrupted);
    thread.join().expect("no panic");
    remove(&path);
}

/// What is asked is a service of this user or of root.
#[test]
fn an_owner_who_is_neither_this_user_nor_root_is_refused() {
    let path = Path::new("/run/isocat-x.sock");
    for owner in [0, 1_000] {
        assert!(check_owner(path, owner, 1_000).is_ok(), "{owner}");
    }
    for owner in [1, 999, 1_001] {
        let error = check_owner(path, owner, 1_000).expect_err("refused");
        assert_eq!(error.kind(), io::ErrorKind::PermissionDenied);
        let text = error.to_string();
        let expected = format!("belongs to user {owner}; expected user 1000 or root");
        assert!(text.contains(&expected), "{text}");
    }
    assert!(check_owner(path, 1_000, 0).is_err(), "root does not ask a user's socket either");
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

/// Only root can make a socket of another user.
#[test]
#[ignore = "needs root: tests/wire.sh runs it"]
fn a_socket_of_another_user_is_not_asked() {
    assert!(rustix::process::geteuid().is_root(), "needs root");
    let path = socket("foreign");
    let _listener = UnixListener::bind(&path).expect("our own folder");
    std::os::unix::fs::chown(&path, Some(12_345), None).expect("root may");
    let error = request(&path, "status").expect_err("refused");
    assert_eq!(error.kind(), io::ErrorKind::PermissionDenied);
    assert!(error.to_string().contains("belongs to user 12345"), "{error}");
    remove(&path);
}
