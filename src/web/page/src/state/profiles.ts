import { type ProcessProfile, profiles as listProfiles } from "meshmend-client";
import { server, serviceState } from "./server";
import { settings } from "./settings";
import { Store } from "./store";

/** The process profiles of the service; empty until they are loaded. */
export const profiles = new Store<readonly ProcessProfile[]>([]);

serviceState.listen(() => {
  if (serviceState.value.is !== "ready") return;
  listProfiles(server).then(
    (list) => profiles.set(list),
    (error: unknown) => console.warn("The process profiles could not be read:", error),
  );
});

/** The options for a new file: alternatives where the file leaves its intent open, and the chosen process, if the service has its profile. */
export function firstOptions(): { alternatives: true; process?: string } {
  const { process } = settings.value;
  const isKnown = profiles.value.some(({ profile }) => profile.name === process);
  return { alternatives: true, ...(isKnown && { process }) };
}
