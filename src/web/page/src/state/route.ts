import { Store } from "./store";

/** The current view of the page. */
export type Route = { at: "repair"; job: string | null } | { at: "jobs" } | { at: "job"; id: string };

export function routeOf(hash: string): Route {
  const [, place, id] = /^#\/([a-z]*)\/?([\w-]*)/.exec(hash) ?? [];
  if (place === "jobs") return id ? { at: "job", id } : { at: "jobs" };
  if (place === "result" && id) return { at: "repair", job: id };
  return { at: "repair", job: null };
}

export const route = new Store<Route>(routeOf(location.hash));
addEventListener("hashchange", () => route.set(routeOf(location.hash)));
