// Server-sent events out of pieces of text, however these are cut. Pure.

/** Takes text in pieces; calls `onEvent({type, data})` for each event that is complete, and `onComment()` for each comment. */
export class EventParser {
  constructor({ onEvent, onComment = () => {} }) {
    Object.assign(this, { onEvent, onComment });
    this.rest = "";
    this.type = "";
    this.data = [];
  }

  feed(text) {
    // A line may end in CR, LF or both; a CR at the end of a piece may have its LF in the next.
    const whole = this.rest + text;
    const isOpen = whole.endsWith("\r");
    const lines = (isOpen ? whole.slice(0, -1) : whole).split(/\r\n|\r|\n/);
    this.rest = lines.pop() + (isOpen ? "\r" : "");
    lines.forEach((line) => this.take(line));
  }

  take(line) {
    if (line === "") {
      if (this.data.length) this.onEvent({ type: this.type || "message", data: this.data.join("\n") });
      this.type = "";
      this.data = [];
      return;
    }
    if (line.startsWith(":")) {
      this.onComment();
      return;
    }
    const [, name, value = ""] = /^([^:]*)(?:: ?(.*))?$/.exec(line);
    if (name === "event") this.type = value;
    else if (name === "data") this.data.push(value);
  }
}
