"""Workers and jobs, open objects and scenes, guard and login, the prediction backend."""
