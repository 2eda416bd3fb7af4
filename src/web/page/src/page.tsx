import { render } from "preact";
import { meet } from "./state/server";
import { App } from "./views/app";

render(<App />, document.getElementById("page")!);
void meet();
