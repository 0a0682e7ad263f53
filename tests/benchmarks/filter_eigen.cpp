// The nine-state filter of gyrocal.fusion with dense 9 x 9 matrices: what one writes first in C++.
// Reads rows of (dt, left, right, gyro in rad/s) from standard input, prints ns a step and the last states.
#include <Eigen/Dense>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <vector>

using Matrix = Eigen::Matrix<double, 9, 9>;
using Vector = Eigen::Matrix<double, 9, 1>;
enum { X, Y, PSI, PHI, BIAS, SCALE, RIGHT, LEFT, WIDTH };

struct Figures { double slip, walk, measurement, gate; };

static void step(Vector& nav, Matrix& p, const Figures& n, const double* row, double* states, double* std) {
    const double dt = row[0], width = nav[WIDTH];
    const double by_gyro = (nav[SCALE] * row[3] + nav[BIAS]) * dt;
    const double r = nav[RIGHT] * row[2], l = nav[LEFT] * row[1];
    const double travel = 0.5 * (r + l), by_wheels = (r - l) / width;
    const double s = std::sin(nav[PSI] + 0.5 * by_wheels), c = std::cos(nav[PSI] + 0.5 * by_wheels);
    const double right = travel + 0.5 * width * by_gyro, left = travel - 0.5 * width * by_gyro;

    Matrix f = Matrix::Identity();
    f(PSI, RIGHT) = right / width;
    f(PSI, LEFT) = -left / width;
    f(PSI, WIDTH) = (left - right) / (width * width);
    f(PHI, BIAS) = dt;
    f(PHI, SCALE) = row[3] * dt;
    f(X, PSI) = -s * travel;
    f(Y, PSI) = c * travel;
    for (int k = RIGHT; k <= WIDTH; ++k) {
        const double half = k == RIGHT ? 0.5 * right : k == LEFT ? 0.5 * left : 0.0;
        f(X, k) = c * half - 0.5 * s * travel * f(PSI, k);
        f(Y, k) = s * half + 0.5 * c * travel * f(PSI, k);
    }
    Matrix q = Matrix::Zero();
    for (int sign = -1; sign <= 1; sign += 2) {
        Vector v = Vector::Zero();
        v[X] = 0.5 * c - sign * 0.5 * s * travel / width;
        v[Y] = 0.5 * s + sign * 0.5 * c * travel / width;
        v[PSI] = sign / width;
        q += n.slip * std::abs(sign > 0 ? right : left) * v * v.transpose();
    }
    q(PHI, PHI) += n.walk * dt;
    p = f * p * f.transpose() + q;

    nav[X] += c * travel;
    nav[Y] += s * travel;
    nav[PSI] += by_wheels;
    nav[PHI] += by_gyro;
    Vector h = Vector::Zero();
    h[PSI] = 1.0;
    h[PHI] = -1.0;
    const double z = nav[PSI] - nav[PHI];
    const double variance = h.dot(p * h) + n.measurement;
    if (z * z > n.gate * variance) std::abort();
    const Vector gain = p * h / variance;
    p = (Matrix::Identity() - gain * h.transpose()) * p;
    const Vector correction = gain * z;
    for (int k = 0; k < 9; ++k)
        if (k == RIGHT || k == LEFT) nav[k] *= 1.0 - correction[k];
        else nav[k] -= correction[k];
    for (int k = 0; k < 9; ++k) {
        states[k] = nav[k];
        std[k] = std::sqrt(p(k, k));
    }
}

int main(int argc, char** argv) {
    if (argc != 16) return 2;
    double a[15];
    for (int k = 0; k < 15; ++k) a[k] = std::atof(argv[k + 1]);
    const Figures figures{a[0], a[1], a[2], a[3]};
    const double file_width = a[4];
    const int repeats = static_cast<int>(a[5]);
    std::vector<double> rows;
    double row[4];
    while (std::fread(row, sizeof row, 1, stdin) == 1) rows.insert(rows.end(), row, row + 4);
    const std::size_t n = rows.size() / 4;
    std::vector<double> states(9 * n), std(9 * n);
    double best = 1e300;
    for (int repeat = 0; repeat < repeats; ++repeat) {
        Vector nav = Vector::Zero();
        nav[SCALE] = nav[RIGHT] = nav[LEFT] = 1.0;
        nav[WIDTH] = file_width;
        Matrix p = Matrix::Zero();
        for (int k = 0; k < 9; ++k) p(k, k) = a[6 + k];
        const auto start = std::chrono::steady_clock::now();
        for (std::size_t k = 0; k < n; ++k) step(nav, p, figures, &rows[4 * k], &states[9 * k], &std[9 * k]);
        const double ns = std::chrono::duration<double, std::nano>(std::chrono::steady_clock::now() - start).count();
        best = ns / n < best ? ns / n : best;
    }
    std::printf("%.17g", best);
    for (int k = 0; k < 9; ++k) std::printf(" %.17g", states[9 * (n - 1) + k]);
    std::printf("\n");
}
