//! The seccomp filters of the sandbox: the system calls that a job's processes can't make.

use std::collections::BTreeMap;

use libc::{EPERM, c_int, c_long};
use seccompiler::{
    BpfProgram, SeccompAction, SeccompCmpArgLen, SeccompCmpOp, SeccompCondition, SeccompFilter, SeccompRule,
    apply_filter,
};

/// System calls that no process in a sandbox needs; they fail with EPERM.
const DENIED: &[c_long] = &[
    // The network, and io_uring, which bypasses filters.
    libc::SYS_socket,
    libc::SYS_io_uring_setup,
    libc::SYS_io_uring_enter,
    libc::SYS_io_uring_register,
    // Other processes.
    libc::SYS_ptrace,
    libc::SYS_process_vm_readv,
    libc::SYS_process_vm_writev,
    libc::SYS_process_madvise,
    libc::SYS_pidfd_getfd,
    libc::SYS_kcmp,
    libc::SYS_migrate_pages,
    libc::SYS_move_pages,
    // Leaving the process group, which the worker kills to end a job.
    libc::SYS_setsid,
    libc::SYS_setpgid,
    // Other namespaces, and the file system as a whole.
    libc::SYS_unshare,
    libc::SYS_setns,
    libc::SYS_mount,
    libc::SYS_umount2,
    libc::SYS_mount_setattr,
    libc::SYS_move_mount,
    libc::SYS_open_tree,
    libc::SYS_fsopen,
    libc::SYS_fsconfig,
    libc::SYS_fsmount,
    libc::SYS_fspick,
    libc::SYS_pivot_root,
    libc::SYS_chroot,
    libc::SYS_swapon,
    libc::SYS_swapoff,
    libc::SYS_quotactl,
    libc::SYS_quotactl_fd,
    // Access to files other than by opening them, which Landlock does not check.
    libc::SYS_truncate,
    libc::SYS_fchmodat,
    FCHMODAT2,
    libc::SYS_fchownat,
    libc::SYS_setxattr,
    libc::SYS_lsetxattr,
    libc::SYS_removexattr,
    libc::SYS_lremovexattr,
    libc::SYS_name_to_handle_at,
    libc::SYS_open_by_handle_at,
    libc::SYS_inotify_init1,
    libc::SYS_inotify_add_watch,
    libc::SYS_fanotify_init,
    libc::SYS_fanotify_mark,
    // Memory that no limit counts.
    libc::SYS_memfd_create,
    libc::SYS_memfd_secret,
    libc::SYS_shmget,
    libc::SYS_semget,
    libc::SYS_msgget,
    libc::SYS_mq_open,
    // Calls that reach large parts of the kernel, and administrators' calls.
    libc::SYS_bpf,
    libc::SYS_perf_event_open,
    libc::SYS_userfaultfd,
    libc::SYS_keyctl,
    libc::SYS_add_key,
    libc::SYS_request_key,
    libc::SYS_init_module,
    libc::SYS_finit_module,
    libc::SYS_delete_module,
    libc::SYS_kexec_load,
    libc::SYS_kexec_file_load,
    libc::SYS_reboot,
    libc::SYS_syslog,
    libc::SYS_acct,
    libc::SYS_settimeofday,
    libc::SYS_clock_settime,
    libc::SYS_clock_adjtime,
    libc::SYS_adjtimex,
    libc::SYS_sethostname,
    libc::SYS_setdomainname,
    libc::SYS_vhangup,
];

/// The same number on every architecture. Not all of libc's lists have it.
const FCHMODAT2: c_long = 452;

/// The same value on all supported architectures. libc's constant has different types with different C libraries.
const TIOCSTI: u64 = 0x5412;

/// Older calls that newer architectures lack.
#[cfg(target_arch = "x86_64")]
const DENIED_OLD: &[c_long] = &[
    libc::SYS_chmod,
    libc::SYS_chown,
    libc::SYS_lchown,
    libc::SYS_inotify_init,
    libc::SYS_ioperm,
    libc::SYS_iopl,
    libc::SYS_modify_ldt,
];
#[cfg(not(target_arch = "x86_64"))]
const DENIED_OLD: &[c_long] = &[];

/// Flags of `clone` that create namespaces.
const NAMESPACES: [c_int; 7] = [
    libc::CLONE_NEWUSER,
    libc::CLONE_NEWNET,
    libc::CLONE_NEWNS,
    libc::CLONE_NEWPID,
    libc::CLONE_NEWIPC,
    libc::CLONE_NEWUTS,
    libc::CLONE_NEWCGROUP,
];

/// Denies system calls to this process and the processes that it starts.
pub(super) fn deny() -> Result<(), String> {
    try_deny().map_err(|error| format!("seccomp failed ({error}); the kernel needs CONFIG_SECCOMP_FILTER"))
}

fn try_deny() -> Result<(), seccompiler::Error> {
    let denied = filter(denied()?, EPERM)?;
    // A filter can't see clone3's arguments, which lie in memory. On ENOSYS the C library assumes an old kernel, and uses clone.
    let clone3 = filter(BTreeMap::from([(libc::SYS_clone3, Vec::new())]), libc::ENOSYS)?;
    #[cfg(target_arch = "x86_64")]
    apply_filter(&NO_X32)?;
    apply_filter(&clone3)?;
    apply_filter(&denied)
}

/// The denied calls, each with rules of which one must match; a call without rules is denied whatever its arguments.
fn denied() -> Result<BTreeMap<i64, Vec<SeccompRule>>, seccompiler::BackendError> {
    let mut denied: BTreeMap<i64, Vec<SeccompRule>> =
        DENIED.iter().chain(DENIED_OLD).map(|&call| (call, Vec::new())).collect();
    let with =
        |argument, length, how, value| SeccompRule::new(vec![SeccompCondition::new(argument, length, how, value)?]);
    let (word, long) = (SeccompCmpArgLen::Dword, SeccompCmpArgLen::Qword);
    let flag = |flag: c_int| {
        let flag = u64::from(flag.cast_unsigned());
        with(0, long.clone(), SeccompCmpOp::MaskedEq(flag), flag)
    };
    denied.insert(libc::SYS_clone, NAMESPACES.into_iter().map(flag).collect::<Result<_, _>>()?);
    // The limits of other processes, such as the worker.
    denied.insert(libc::SYS_prlimit64, vec![with(0, word.clone(), SeccompCmpOp::Ne, 0)?]);
    // Input into a terminal (TIOCSTI).
    denied.insert(libc::SYS_ioctl, vec![with(1, word, SeccompCmpOp::Eq, TIOCSTI)?]);
    Ok(denied)
}

/// A filter with these rules. It ends a process that makes calls of another architecture.
fn filter(rules: BTreeMap<i64, Vec<SeccompRule>>, errno: c_int) -> Result<BpfProgram, seccompiler::BackendError> {
    let refuse = SeccompAction::Errno(errno.cast_unsigned());
    let architecture = std::env::consts::ARCH.try_into()?;
    SeccompFilter::new(rules, SeccompAction::Allow, refuse, architecture)?.try_into()
}

/// Refuses the calls of the x32 ABI: their numbers have an extra bit, so that the filters above would not match.
#[cfg(target_arch = "x86_64")]
const NO_X32: [seccompiler::sock_filter; 4] = {
    use seccompiler::sock_filter;
    const X32_BIT: u32 = 0x4000_0000;
    const NUMBER: u32 = 0;
    const REFUSE: u32 = libc::SECCOMP_RET_ERRNO | libc::ENOSYS.cast_unsigned();
    const LOAD: u16 = (libc::BPF_LD | libc::BPF_W | libc::BPF_ABS) as u16;
    const AT_LEAST: u16 = (libc::BPF_JMP | libc::BPF_JGE | libc::BPF_K) as u16;
    const RETURN: u16 = (libc::BPF_RET | libc::BPF_K) as u16;
    [
        sock_filter { code: LOAD, jt: 0, jf: 0, k: NUMBER },
        sock_filter { code: AT_LEAST, jt: 0, jf: 1, k: X32_BIT },
        sock_filter { code: RETURN, jt: 0, jf: 0, k: REFUSE },
        sock_filter { code: RETURN, jt: 0, jf: 0, k: libc::SECCOMP_RET_ALLOW },
    ]
};
