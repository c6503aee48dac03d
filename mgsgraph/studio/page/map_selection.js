// Points that were selected on the map, by a box or by a least value: their names, their number, their marks.

import {button, caption, form, make, short} from './plot.js';

export class MapSelection {
  constructor(map) {
    Object.assign(this, {map, found: null}); // what the server has answered last
    this.words = caption('');
    this.names = make('ul', {className: 'names', ariaLabel: 'Selected points'});
    this.least = make('input', {type: 'number', step: 'any', title: 'Least value of what the points are colored by', required: true});
    const select = () => this.ask({least: this.least.value}, `of at least ${this.least.value}`);
    this.form = form('', 'Select by value', select, () => {}, make('label', {}, 'at least ', this.least), ' ',
      make('button', {type: 'submit', textContent: 'Select'}));
  }

  inside([x0, y0, x1, y1]) {
    return this.ask({x0, y0, x1, y1}, 'in the box');
  }

  async ask(which, words) {
    const {app, value} = this.map;
    const asked = new URLSearchParams({...which, value: value.value, classes: this.map.asked().get('classes')});
    const found = await app.orSay(app.request(`/api/select?${asked}`));
    if (!found) return;
    this.found = found;
    const {count, names, values, order, unit} = found;
    this.words.textContent = `${count} points ${words}${count > names.length ? `, the ${names.length} of the largest ${order} are listed` : ''}; ${order} in ${unit}.`;
    this.names.replaceChildren(...names.map((name, k) => {
      const one = button('', () => app.select(name), {value: name});
      one.append(make('span', {textContent: name}), make('span', {textContent: short(values[k])}));
      return make('li', {}, one);
    }));
    this.mark();
  }

  mark() {
    for (const one of this.names.querySelectorAll('button')) one.setAttribute('aria-current', String(one.value === this.map.app.selection));
    this.map.render();
  }
}
