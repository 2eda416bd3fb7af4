import { type Capabilities, type Server, Problem, capabilities } from "meshmend-client";
import { Store } from "./store";

const NAME = "meshmend.key";

/** The API key, if the service requires one. It lives in the session storage of this tab, never in a cookie. */
export const key = new Store<string | null>(sessionStorage.getItem(NAME));

key.listen(() => {
  if (key.value) sessionStorage.setItem(NAME, key.value);
  else sessionStorage.removeItem(NAME);
});

export const server: Server = { base: "", key: () => key.value };

/** The state of the service: unknown yet, ready with its capabilities, locked until a key is entered, or unreachable. */
export type ServiceState = { is: "asking" } | { is: "ready"; can: Capabilities } | { is: "locked"; refused: boolean } | { is: "away"; problem: Problem };

export const serviceState = new Store<ServiceState>({ is: "asking" });

export async function connect(): Promise<void> {
  try {
    serviceState.set({ is: "ready", can: await capabilities(server) });
  } catch (error) {
    const problem = error instanceof Problem ? error : Problem.unreachable();
    if (problem.status === 401 || problem.status === 403) serviceState.set({ is: "locked", refused: key.value !== null });
    else serviceState.set({ is: "away", problem });
  }
}

/** Locks the page if a request failed because of an invalid or revoked key. */
export function lockIfUnauthorized(problem: Problem): void {
  if (problem.code === "unauthorized") serviceState.set({ is: "locked", refused: key.value !== null });
}
