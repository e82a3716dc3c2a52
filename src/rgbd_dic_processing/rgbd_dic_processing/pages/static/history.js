// Undo and redo of a JSON value. `drag` marks changes that belong to one movement and are undone together.

export class History {
  constructor(value) {
    this.reset(value);
  }

  reset(value) {
    this.value = structuredClone(value);
    this.past = [];
    this.future = [];
  }

  change(edit, drag = null) {
    if (!drag || !drag.begun) {
      this.past.push(structuredClone(this.value));
      this.future = [];
    }
    if (drag) drag.begun = true;
    edit(this.value);
  }

  undo() {
    this.step(this.past, this.future);
  }

  redo() {
    this.step(this.future, this.past);
  }

  step(from, to) {
    if (!from.length) return;
    to.push(this.value);
    this.value = from.pop();
  }
}
