//! The layers of the sandbox, and how a process enters them.

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

/// What to do where the kernel can't give every wall.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum SandboxMode {
    /// Use what there is.
    #[default]
    Auto,
    /// Run nothing where the network or the files are open.
    Require,
    /// No walls; for debugging.
    Off,
}

/// A sandbox for the calling process and all that it starts.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sandbox {
    /// What to do where a wall can't be had.
    pub mode: SandboxMode,
    /// Files and folders to read, and to start programs from, beside those of the system.
    pub readable: Vec<PathBuf>,
    /// Most processes and threads, where a user namespace counts them.
    pub max_processes: u64,
}

/// What came of each layer: how it is called, or why it is not there.
#[derive(Debug)]
pub(super) struct Layers {
    pub network_namespace: Result<(), String>,
    pub process_count: Result<(), String>,
    pub landlock: Result<String, String>,
    pub seccomp: Result<(), String>,
}

impl Sandbox {
    /// Enters the sandbox, in which `folder` can be written and nothing else. There is no way out.
    ///
    /// # Errors
    /// When the process has more than one thread, since only the calling one would be inside, and where a wall is missing that is
    /// required.
    pub fn enter(&self, folder: &Path) -> io::Result<()> {
        self.enter_layers(folder).map(drop)
    }

    pub(super) fn enter_layers(&self, folder: &Path) -> io::Result<Option<Layers>> {
        if self.mode == SandboxMode::Off {
            return Ok(None);
        }
        let threads = fs::read_dir("/proc/self/task")?.count();
        if threads != 1 {
            return Err(io::Error::other(format!("a sandbox is for a process of one thread; this one has {threads}")));
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
    /// Why the network or the files are open.
    fn missing(&self) -> Option<String> {
        match (&self.network_namespace, &self.seccomp, &self.landlock) {
            (Err(namespace), Err(seccomp), _) => Some(format!("the network is open: {namespace}; {seccomp}")),
            (.., Err(landlock)) => Some(format!("the files are open: {landlock}")),
            _ => None,
        }
    }
}

/// The first kernel that counts the processes of a user namespace apart from those of the same user outside.
const COUNTS_BY_NAMESPACE: (u32, u32) = (5, 14);

/// Moves this process into a network of its own, which has no way out, and limits the processes there. Gives what came of
/// each.
fn enter_namespaces(max_processes: u64) -> (Result<(), String>, Result<(), String>) {
    let (user, group) = (geteuid().as_raw(), getegid().as_raw());
    let refused = match unshare(CloneFlags::CLONE_NEWUSER | CloneFlags::CLONE_NEWNET) {
        Ok(()) => {
            keep_names(user, group);
            return (Ok(()), limit_processes(user, max_processes));
        }
        Err(error) => error,
    };
    let no_count = Err(format!("the kernel refuses a user namespace ({refused})"));
    // Without a user namespace, for those who may.
    match unshare(CloneFlags::CLONE_NEWNET) {
        Ok(()) => (Ok(()), no_count),
        Err(_) => (
            Err(format!(
                "the kernel refuses a network namespace ({refused}); on the host, see the settings user.max_user_namespaces, \
                 kernel.unprivileged_userns_clone and kernel.apparmor_restrict_unprivileged_userns; in a container, use a \
                 seccomp profile that allows unshare"
            )),
            no_count,
        ),
    }
}

/// Lets the user and the group be called inside what they are called outside. Where that is refused they have no name inside,
/// and own their files all the same.
fn keep_names(user: u32, group: u32) {
    let _ = fs::write("/proc/self/setgroups", "deny");
    let _ = fs::write("/proc/self/gid_map", format!("{group} {group} 1"));
    let _ = fs::write("/proc/self/uid_map", format!("{user} {user} 1"));
}

fn limit_processes(user: u32, max: u64) -> Result<(), String> {
    if user == 0 {
        return Err("the kernel puts no limit on root's processes; run the service as another user".to_owned());
    }
    let release = rustix::system::uname().release().to_string_lossy().into_owned();
    if kernel_version(&release).is_none_or(|version| version < COUNTS_BY_NAMESPACE) {
        return Err(format!("Linux {release} counts all processes of the user; Linux 5.14 counts those of a sandbox"));
    }
    let limit = Resource::NPROC.get().and_then(|(_, hard)| Resource::NPROC.set(max.min(hard), max.min(hard)));
    limit.map_err(|error| format!("the limit was refused ({error})"))
}

/// Major and minor number of a release such as `6.1.0-18-amd64`.
fn kernel_version(release: &str) -> Option<(u32, u32)> {
    let mut numbers = release.split(|c: char| !c.is_ascii_digit()).map(str::parse);
    Some((numbers.next()?.ok()?, numbers.next()?.ok()?))
}

/// Gives up what a privileged user may do, and what comes with a user namespace: most of the kernel that unprivileged users
/// can't reach otherwise. Since no program can gain privileges any more, they don't come back.
fn drop_capabilities() -> io::Result<()> {
    let none = CapabilitySet::empty();
    // First, since it is above what is permitted otherwise.
    let _ = rustix::thread::clear_ambient_capability_set();
    set_capabilities(None, CapabilitySets { effective: none, permitted: none, inheritable: none })?;
    Ok(())
}

/// The newest rights that this program knows of; an older kernel gives those that it has.
const NEWEST: ABI = ABI::V9;

/// Where programs and their libraries are, read and run.
const PROGRAMS: [&str; 10] =
    ["/usr", "/bin", "/sbin", "/lib", "/lib32", "/lib64", "/libx32", "/nix/store", "/gnu/store", "/etc/alternatives"];

/// What programs read: how to find libraries, fonts and the local time; what machine this is and how much memory it has; random
/// numbers. Other processes show their command lines in `/proc`, and nothing more.
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

/// Devices without content.
const EMPTY: [&str; 2] = ["/dev/null", "/dev/zero"];

/// What may be done in the folder that can be written: no programs, devices, sockets, pipes or links, which could lead the
/// worker elsewhere when it comes for the results.
const WRITABLE: BitFlags<AccessFs> = make_bitflags!(AccessFs::{ReadFile | ReadDir | WriteFile | Truncate | MakeReg | MakeDir | RemoveFile | RemoveDir | Refer});

/// Leaves this process and what it starts only the files that programs need, and `folder` to write; no TCP and no signals to
/// others. Gives the name of what is in force.
fn restrict_files(readable: &[PathBuf], folder: &Path) -> Result<String, String> {
    let status = try_restrict_files(readable, folder).map_err(|error| format!("Landlock failed ({error})"))?;
    match status.landlock {
        LandlockStatus::NotEnabled => Err("Landlock is not enabled; add it to the kernel's parameter lsm=".to_owned()),
        LandlockStatus::NotImplemented => {
            Err("the kernel has no Landlock (it is part of Linux 5.13), or the container's \
                                               seccomp profile refuses it"
                .to_owned())
        }
        LandlockStatus::Available { .. } if status.ruleset == RulesetStatus::NotEnforced => {
            Err("the kernel did not put Landlock in force".to_owned())
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

/// Where Debian keeps parts of the library of its Pythons.
fn python_settings() -> impl Iterator<Item = PathBuf> {
    let entries = fs::read_dir("/etc").into_iter().flatten().flatten();
    entries.filter(|entry| entry.file_name().to_string_lossy().starts_with("python")).map(|entry| entry.path())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_kernels_version_is_read_from_its_release() {
        assert_eq!(kernel_version("6.1.0-18-amd64"), Some((6, 1)));
        assert_eq!(kernel_version("5.14-rc1"), Some((5, 14)));
        assert_eq!(kernel_version("unknown"), None);
    }
}
