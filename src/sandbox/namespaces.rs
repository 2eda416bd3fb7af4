use std::fs;
use std::io;

use nix::sched::{CloneFlags, unshare};
use rlimit::Resource;
use rustix::process::{getegid, geteuid};
use rustix::thread::{CapabilitySet, CapabilitySets, set_capabilities};

/// The first kernel that counts the processes of a user namespace apart from those of the same user outside.
const COUNTS_BY_NAMESPACE: (u32, u32) = (5, 14);

/// Moves this process into a network of its own, which has no way out, and limits the processes there. Gives what came of
/// each.
pub(super) fn enter(max_processes: u64) -> (Result<(), String>, Result<(), String>) {
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
pub(super) fn drop_capabilities() -> io::Result<()> {
    let none = CapabilitySet::empty();
    // First, since it is above what is permitted otherwise.
    let _ = rustix::thread::clear_ambient_capability_set();
    set_capabilities(None, CapabilitySets { effective: none, permitted: none, inheritable: none })?;
    Ok(())
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
