// One block whose groups take runs until there are none.
extern "C" void run_block(const Job *job) {
  std::vector<REAL> memory((size_t)BLOCK * SLOTS + 64);
  std::vector<std::unique_ptr<Group>> groups;
  for (int g = 0; g < 2; g++) groups.push_back(std::make_unique<Group>(GROUP));
  std::vector<std::thread> threads;
  for (unsigned t = 0; t < 2 * GROUP; t++)
    threads.emplace_back([&, t] {
      threadIdx.x = t;
      my_group = groups[t / GROUP].get();
      my_memory = memory.data();
      homeward_batch(*job);
    });
  for (auto &thread : threads) thread.join();
}
