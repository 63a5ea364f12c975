"""Views: what colour and depth cameras see of scenes, with labels, to learn from and to judge by."""
