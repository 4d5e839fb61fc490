// Numbers that count what is done with them.
#pragma once
#include <cmath>
extern long arithmetic, functions;
struct Counting {
  double x;
  Counting(double given = 0) : x(given) {}
  template <class T> explicit operator T() const { return (T)x; }
  Counting &operator+=(Counting b) { return arithmetic++, x += b.x, *this; }
  Counting &operator-=(Counting b) { return arithmetic++, x -= b.x, *this; }
  Counting operator-() const { return -x; }
};
#define OPERATION(op) inline Counting operator op(Counting a, Counting b) { return arithmetic++, a.x op b.x; }
#define COMPARISON(op) inline bool operator op(Counting a, Counting b) { return a.x op b.x; }
#define FUNCTION(f) inline Counting f(Counting a) { return functions++, std::f(a.x); }
OPERATION(+) OPERATION(-) OPERATION(*) OPERATION(/)
COMPARISON(<) COMPARISON(>) COMPARISON(<=) COMPARISON(>=)
FUNCTION(sin) FUNCTION(cos) FUNCTION(sqrt) FUNCTION(ceil)
inline Counting atan2(Counting y, Counting x) { return functions++, std::atan2(y.x, x.x); }
