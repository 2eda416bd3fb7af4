//! The layers of the sandbox, and how a process enters them: namespaces, capabilities, Landlock and seccomp.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use landlock::{
    ABI, Access, AccessFs, AccessNet, BitFlags, LandlockStatus, Ruleset, RulesetAttr, RulesetCreatedAttr, RulesetError,
    RulesetStatus, Scope, make_bitflags, path_beneath_rules,
};
use nix::sched::{CloneFlags, unshare};
use rlimit::Resource;
use rustix::process::{getegid, geteuid};
use rustix::thread::{CapabilitySet, CapabilitySets, set_capabilities};
use serde::{Deserialize, Serialize};

use super::seccomp;

/// What to do where the kernel can't provide every protection.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum SandboxMode {
    /// Use the protections that the kernel offers.
    #[default]
    Auto,
    /// Refuse to run jobs without protection of the network and of files.
    Require,
    /// Use no protections; for debugging.
    Off,
}

/// The sandbox of a process and of all processes that it starts.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sandbox {
    /// What to do where a protection is not available.
    pub mode: SandboxMode,
    /// Files and folders that may be read, and from which programs may be started, besides those of the system.
    pub readable: Vec<PathBuf>,
    /// The most processes and threads, where a user namespace counts them.
    pub max_processes: u64,
}

/// The result of each layer: an error says why the layer is missing.
#[derive(Debug)]
pub(super) struct Layers {
    /// Separate network without connections.
    pub network_namespace: Result<(), String>,
    /// Limit on processes and threads.
    pub process_count: Result<(), String>,
    /// Limit on files and signals, with the mechanism's name and version.
    pub landlock: Result<String, String>,
    /// Limit on system calls.
    pub seccomp: Result<(), String>,
}

impl Sandbox {
    /// Enters the sandbox for good. Of all files, only those in `folder` can be written then.
    ///
    /// # Errors
    /// When the process has several threads, since only the calling thread would enter. Also when a required protection is missing.
    pub fn enter(&self, folder: &Path) -> io::Result<()> {
        self.enter_layers(folder).map(drop)
    }

    /// Enters the sandbox, and returns the result of each layer; `None` if the mode is `off`.
    pub(super) fn enter_layers(&self, folder: &Path) -> io::Result<Option<Layers>> {
        if self.mode == SandboxMode::Off {
            return Ok(None);
        }
        let threads = fs::read_dir("/proc/self/task")?.count();
        if threads != 1 {
            return Err(io::Error::other(format!(
                "a process must have a single thread to enter the sandbox; this process has {threads}"
            )));
        }
        rustix::thread::set_no_new_privs(true)?;
        let (network_namespace, process_count) = enter_namespaces(self.max_processes);
        drop_capabilities()?;
        let landlock = restrict_files(&self.readable, folder);
        let seccomp = seccomp::deny();
        let layers = Layers { network_namespace, process_count, landlock, seccomp };
        if self.mode == SandboxMode::Require
            && let Some(missing) = layers.missing()
        {
            return Err(io::Error::other(missing));
        }
        Ok(Some(layers))
    }
}

impl Layers {
    /// The reason why the network or files are not protected, if any.
    fn missing(&self) -> Option<String> {
        match (&self.network_namespace, &self.seccomp, &self.landlock) {
            (Err(namespace), Err(seccomp), _) => Some(format!("the network is not blocked: {namespace}; {seccomp}")),
            (.., Err(landlock)) => Some(format!("files are not protected: {landlock}")),
            _ => None,
        }
    }
}

/// The first kernel that counts a user namespace's processes separately from the same user's other processes.
const COUNTS_BY_NAMESPACE: (u32, u32) = (5, 14);

/// Moves this process into its own network namespace without connections, and limits its processes. Returns the results of the
/// network namespace and of the limit.
fn enter_namespaces(max_processes: u64) -> (Result<(), String>, Result<(), String>) {
    let (user, group) = (geteuid().as_raw(), getegid().as_raw());
    let error = match unshare(CloneFlags::CLONE_NEWUSER | CloneFlags::CLONE_NEWNET) {
        Ok(()) => {
            keep_ids(user, group);
            return (Ok(()), limit_processes(user, max_processes));
        }
        Err(error) => error,
    };
    let no_count = Err(format!("the kernel refuses a user namespace ({error})"));
    // A privileged process needs no user namespace for a network namespace.
    match unshare(CloneFlags::CLONE_NEWNET) {
        Ok(()) => (Ok(()), no_count),
        Err(_) => (
            Err(format!(
                "the kernel refuses a network namespace ({error}); on the host, check the settings `user.max_user_namespaces`, \
                 `kernel.unprivileged_userns_clone` and `kernel.apparmor_restrict_unprivileged_userns`; in a container, use a \
                 seccomp profile that allows `unshare`"
            )),
            no_count,
        ),
    }
}

/// Maps the user id and the group id to themselves in the namespace. Without the mapping, both ids are unknown inside, but the
/// process still owns its files.
fn keep_ids(user: u32, group: u32) {
    let _ = fs::write("/proc/self/setgroups", "deny");
    let _ = fs::write("/proc/self/gid_map", format!("{group} {group} 1"));
    let _ = fs::write("/proc/self/uid_map", format!("{user} {user} 1"));
}

/// Limits the processes and threads of the user namespace.
fn limit_processes(user: u32, max: u64) -> Result<(), String> {
    if user == 0 {
        return Err("the kernel does not limit root's processes; run the service as another user".to_owned());
    }
    let release = rustix::system::uname().release().to_string_lossy().into_owned();
    if kernel_version(&release).is_none_or(|version| version < COUNTS_BY_NAMESPACE) {
        return Err(format!(
            "Linux {release} counts all processes of the user; Linux 5.14 or later counts those of a sandbox separately"
        ));
    }
    let limit = Resource::NPROC.get().and_then(|(_, hard)| Resource::NPROC.set(max.min(hard), max.min(hard)));
    limit.map_err(|error| format!("the limit on processes was refused ({error})"))
}

/// Major and minor number of a release such as `6.1.0-18-amd64`.
fn kernel_version(release: &str) -> Option<(u32, u32)> {
    let mut numbers = release.split(|c: char| !c.is_ascii_digit()).map(str::parse);
    Some((numbers.next()?.ok()?, numbers.next()?.ok()?))
}

/// Drops all capabilities, those of a privileged user and those of a new user namespace. They would open parts of the kernel
/// that unprivileged users can't reach. Since `no_new_privs` is set, no program can regain them.
fn drop_capabilities() -> io::Result<()> {
    let none = CapabilitySet::empty();
    // The ambient set goes first: it may exceed the permitted set otherwise.
    let _ = rustix::thread::clear_ambient_capability_set();
    set_capabilities(None, CapabilitySets { effective: none, permitted: none, inheritable: none })?;
    Ok(())
}

/// The newest Landlock ABI that this program knows; an older kernel applies the rights that it has.
const NEWEST: ABI = ABI::V9;

/// Folders of programs and their libraries, which may be read and executed.
const PROGRAMS: [&str; 10] =
    ["/usr", "/bin", "/sbin", "/lib", "/lib32", "/lib64", "/libx32", "/nix/store", "/gnu/store", "/etc/alternatives"];

/// Files that programs read: to find libraries, fonts and the local time; to learn about the machine and its memory; and for random
/// numbers. In `/proc`, other processes show only their command lines.
const SYSTEM: [&str; 13] = [
    "/etc/fonts",
    "/etc/ld.so.cache",
    "/etc/ld.so.conf",
    "/etc/ld.so.conf.d",
    "/etc/ld.so.preload",
    "/etc/localtime",
    "/etc/nsswitch.conf",
    "/etc/passwd",
    "/proc",
    "/sys/devices/system",
    "/sys/fs/cgroup",
    "/dev/random",
    "/dev/urandom",
];

/// Devices without content, which may be read and written.
const EMPTY: [&str; 2] = ["/dev/null", "/dev/zero"];

/// Rights in the writable folder. A job can't create devices, sockets, pipes or links there, which could lead the worker elsewhere
/// when it collects the results, and it can't run programs from there.
const WRITABLE: BitFlags<AccessFs> = make_bitflags!(AccessFs::{ReadFile | ReadDir | WriteFile | Truncate | MakeReg | MakeDir | RemoveFile | RemoveDir | Refer});

/// Limits this process and its children to the files that programs need and to writing in `folder`. Also denies TCP, and signals to
/// processes outside. Returns the name and the version of the mechanism.
fn restrict_files(readable: &[PathBuf], folder: &Path) -> Result<String, String> {
    let status = try_restrict_files(readable, folder).map_err(|error| format!("Landlock failed ({error})"))?;
    match status.landlock {
        LandlockStatus::NotEnabled => {
            Err("Landlock is not enabled; add landlock to the kernel's boot parameter lsm=".to_owned())
        }
        LandlockStatus::NotImplemented => Err(
            "the kernel has no Landlock (Linux 5.13 or later has it), or the container's seccomp profile refuses it"
                .to_owned(),
        ),
        LandlockStatus::Available { .. } if status.ruleset == RulesetStatus::NotEnforced => {
            Err("the kernel did not enforce Landlock".to_owned())
        }
        LandlockStatus::Available { effective_abi, .. } => Ok(format!("landlock {}", effective_abi as i32)),
    }
}

fn try_restrict_files(readable: &[PathBuf], folder: &Path) -> Result<landlock::RestrictionStatus, RulesetError> {
    let read = AccessFs::ReadFile | AccessFs::ReadDir;
    Ruleset::default()
        .handle_access(AccessFs::from_all(NEWEST))?
        .handle_access(AccessNet::from_all(NEWEST))?
        .scope(Scope::from_all(NEWEST))?
        .create()?
        .add_rules(path_beneath_rules(PROGRAMS, read | AccessFs::Execute))?
        .add_rules(path_beneath_rules(readable, read | AccessFs::Execute))?
        .add_rules(path_beneath_rules(python_settings(), read))?
        .add_rules(path_beneath_rules(SYSTEM, read))?
        .add_rules(path_beneath_rules(EMPTY, AccessFs::ReadFile | AccessFs::WriteFile))?
        .add_rules(path_beneath_rules([folder], WRITABLE))?
        .restrict_self()
}

/// Folders in which Debian keeps parts of Python's standard library.
fn python_settings() -> impl Iterator<Item = PathBuf> {
    let entries = fs::read_dir("/etc").into_iter().flatten().flatten();
    entries.filter(|entry| entry.file_name().to_string_lossy().starts_with("python")).map(|entry| entry.path())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_kernel_version_is_parsed_from_the_release() {
        assert_eq!(kernel_version("6.1.0-18-amd64"), Some((6, 1)));
        assert_eq!(kernel_version("5.14-rc1"), Some((5, 14)));
        assert_eq!(kernel_version("unknown"), None);
    }
}
