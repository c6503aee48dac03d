// Points that were selected on the map, by a box or by a least value: their names, their number, their marks.

import {make, short} from './plot.js';

export class MapSelection {
  constructor(map) {
    Object.assign(this, {map, found: null}); // what the server has answered last
    this.words = make('p', {className: 'caption'});
    this.names = make('ul', {className: 'names', ariaLabel: 'Selected points'});
    this.least = make('input', {type: 'number', step: 'any', title: 'Least value of the color', required: true});
    this.form = make('form', {onsubmit: event => {
      event.preventDefault();
      this.ask({least: this.least.value}, `of at least ${this.least.value}`);
    }}, make('label', {}, 'at least ', this.least), ' ', make('button', {type: 'submit', textContent: 'Select'}));
  }

  inside([x0, y0, x1, y1]) {
    return this.ask({x0, y0, x1, y1}, 'in the box');
  }

  async ask(which, words) {
    const {app, value} = this.map;
    try {
      this.found = await app.request(`/api/select?${new URLSearchParams({...which, value: value.value, classes: this.map.asked().get('classes')})}`);
    } catch (error) {
      return app.say(error.message, 'error');
    }
    const {count, names, values, order, unit} = this.found;
    this.words.textContent = `${count} points ${words}${count > names.length ? `, the ${names.length} of the largest ${order} are listed` : ''}; ${order} in ${unit}.`;
    this.names.replaceChildren(...names.map((name, k) => {
      const one = make('button', {type: 'button', onclick: () => app.select(name)}, make('span', {textContent: name}), make('span', {textContent: short(values[k])}));
      one.dataset.point = name;
      return make('li', {}, one);
    }));
    return this.mark();
  }

  mark() {
    for (const one of this.names.querySelectorAll('button')) one.setAttribute('aria-current', String(one.dataset.point === this.map.app.selection));
    this.map.render();
  }
}
