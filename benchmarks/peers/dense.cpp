// A dense Kalman filter of 15 states, written by hand: predict and a 6-dim update, nothing else
// (no mechanization, no heading, no sparsity). It is what `handcal bench` holds the filter against.
//
//   g++ -O3 -march=native dense.cpp -o dense && ./dense plain|vectors
//
// plain: loops over rows padded to sixteen, and what the compiler makes of them. vectors: the
// same sums, eight numbers at a time, with the vector types that GCC and Clang share.
// It answers as the other peers do (see _serve.py).

#include <chrono>
#include <cstdio>
#include <cstring>
#include <ctime>

constexpr int N = 15, WIDE = 16, M = 6, STEPS = 300000;
typedef double Eight __attribute__((vector_size(64)));

union alignas(64) Row {
    double at[WIDE];
    Eight half[2];
};

struct Filter {
    Row P[N], F[N], Q[N], H[M], x;
    double R[M], z[M];
};

struct Plain {
    static void add(Row& out, double a, const Row& x) {
        for (int j = 0; j < WIDE; j++) out.at[j] += a * x.at[j];
    }
};

struct Vectors {
    static void add(Row& out, double a, const Row& x) {
        out.half[0] += a * x.half[0];
        out.half[1] += a * x.half[1];
    }
};

template <class How>
__attribute__((noinline)) void predict(Filter& f) {
    Row FP[N], F_t[N] = {}, x = {};
    for (int i = 0; i < N; i++) {
        Row sum = {};
        for (int k = 0; k < N; k++) How::add(sum, f.F[i].at[k], f.P[k]);
        FP[i] = sum;
    }
    for (int i = 0; i < N; i++)
        for (int j = 0; j < N; j++) F_t[j].at[i] = f.F[i].at[j];
    for (int k = 0; k < N; k++) How::add(x, f.x.at[k], F_t[k]);
    for (int i = 0; i < N; i++) {
        Row sum = f.Q[i];
        for (int k = 0; k < N; k++) How::add(sum, FP[i].at[k], F_t[k]);
        f.P[i] = sum;
    }
    f.x = x;
}

// one scalar after the other, P - K h P
template <class How>
__attribute__((noinline)) void update(Filter& f) {
    for (int m = 0; m < M; m++) {
        const Row& h = f.H[m];
        Row Ph = {}, gain = {};
        for (int k = 0; k < N; k++) How::add(Ph, h.at[k], f.P[k]);
        double S = f.R[m], nu = f.z[m];
        for (int j = 0; j < N; j++) {
            S += h.at[j] * Ph.at[j];
            nu -= h.at[j] * f.x.at[j];
        }
        How::add(gain, 1.0 / S, Ph);
        How::add(f.x, nu, gain);
        for (int i = 0; i < N; i++) How::add(f.P[i], -gain.at[i], Ph);
    }
}

template <class How>
void work(Filter& f) {
    for (int i = 0; i < STEPS; i++) {
        predict<How>(f);
        update<How>(f);
    }
}

int main(int count, char** arguments) {
    static Filter f;
    for (int i = 0; i < N; i++) {
        f.P[i].at[i] = 1.0;
        f.Q[i].at[i] = 1e-6;
        for (int j = 0; j < N; j++) f.F[i].at[j] = i == j ? 0.99 : 1e-3 * ((7 * i + 3 * j) % 5 - 2);
    }
    for (int m = 0; m < M; m++) {
        f.H[m].at[m] = 1.0;
        f.R[m] = 1e-2;
        f.z[m] = 1e-2;
    }
    bool plain = count > 1 && !std::strcmp(arguments[1], "plain");
    auto run = [&] { plain ? work<Plain>(f) : work<Vectors>(f); };
    run();
    std::printf("ready dense C++\n");
    std::fflush(stdout);
    while (std::getchar() != EOF) {
        auto wall = std::chrono::steady_clock::now();
        std::clock_t cpu = std::clock();
        run();
        double spent = double(std::clock() - cpu) / CLOCKS_PER_SEC;
        std::chrono::duration<double> passed = std::chrono::steady_clock::now() - wall;
        std::printf("%d %.9f %.9f\n", STEPS, spent, passed.count());
        std::fflush(stdout);
        if (f.P[3].at[3] > 1.0) return 1;  // (P is looked at, so it has to be computed)
    }
}
