import { render } from "preact";
import { connect } from "./state/server";
import { Page } from "./views/app";

render(<Page />, document.getElementById("page")!);
void connect();
