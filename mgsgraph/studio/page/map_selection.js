// Points that were selected on the map, by a box or by a least value: their names, their number, their marks.

import {make, short} from './plot.js';

export class MapSelection {
  constructor(map) {
    this.map = map;
    this.found = null; // what the server has answered last
    this.words = make('p', {className: 'caption'});
    this.names = make('ul', {className: 'names'});
    this.names.setAttribute('aria-label', 'Selected points');
    this.least = make('input', {type: 'number', step: 'any', title: 'Least value of the color'});
    this.form = make('form', {}, make('label', {}, 'at least ', this.least), ' ', make('button', {type: 'submit', textContent: 'Select'}));
    this.form.addEventListener('submit', event => { event.preventDefault(); this.above(); });
  }

  async inside([x0, y0, x1, y1]) {
    const asked = this.map.asked();
    for (const [key, value] of Object.entries({x0, y0, x1, y1})) asked.set(key, value);
    await this.ask(asked, 'in the box');
  }

  async above() {
    if (this.least.value === '') return this.map.app.say('Say from which value on points are to be selected.', 'error');
    const asked = this.map.asked();
    for (const key of ['x0', 'y0', 'x1', 'y1']) asked.delete(key);
    asked.set('least', this.least.value);
    return this.ask(asked, `of at least ${this.least.value}`);
  }

  async ask(asked, words) {
    try {
      this.found = await this.map.app.request(`/api/select?${asked}`);
    } catch (error) {
      return this.map.app.say(error.message, 'error');
    }
    const {count, names, values, order, unit} = this.found;
    this.words.textContent = `${count} points ${words}${count > names.length ? `, the ${names.length} of the largest ${order} are listed` : ''}; ${order} in ${unit}.`;
    this.names.replaceChildren(...names.map((name, k) => {
      const one = make('button', {type: 'button'}, make('span', {textContent: name}), make('span', {textContent: short(values[k])}));
      one.dataset.point = name;
      one.addEventListener('click', () => this.map.app.select(name));
      return make('li', {}, one);
    }));
    this.mark();
    return undefined;
  }

  mark() {
    for (const one of this.names.querySelectorAll('button')) one.setAttribute('aria-current', String(one.dataset.point === this.map.app.selection));
    this.map.render();
  }
}
